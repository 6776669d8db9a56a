/* Output and ticks, on the board and on the host alike; included once in a program. SysTick counts down 24 bits. */
#include <stdint.h>

void put_text(const char *text);

#ifdef __arm__
unsigned stack_used(void);
unsigned stack_of(void (*call)(void));
#define TICKS (*(volatile uint32_t *)0xE000E018)
#else
#include <stdio.h>
#define TICKS 0u
static inline unsigned stack_of(void (*call)(void)) { return call(), 0; }
void put_text(const char *text) { fputs(text, stdout); }
#endif

static void put_number(uint32_t value) {
  char text[12], *p = text + sizeof text - 1;
  *p = 0;
  do *--p = (char)('0' + value % 10);
  while (value /= 10);
  put_text(p);
  put_text(" ");
}
