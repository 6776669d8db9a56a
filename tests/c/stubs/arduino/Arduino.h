/* What the exported sketch uses of Arduino, for a build on the host. */
#include <stdint.h>
#include <stdio.h>

static uint32_t stub_time = 4294000000u; /* micros() starts again soon */
static inline uint32_t micros(void) { return stub_time += 100; }
struct {
  void begin(long) {}
  void print(const char *text) { printf("%s", text); }
  void print(char letter) { printf("%c", letter); }
  void print(long number) { printf("%ld", number); }
  void print(float number, int) { printf("%g", (double)number); }
  void println(const char *text) { printf("%s\n", text); }
  void println(unsigned long number) { printf("%lu\n", number); }
  void println(int number) { printf("%d\n", number); }
} Serial;
