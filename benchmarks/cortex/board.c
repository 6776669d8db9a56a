/* A Cortex-M without an operating system: vectors, floating point on, output through the debugger, stack painted. */
#include <stdint.h>

int main(void);
void put_text(const char *text);
unsigned stack_used(void);
unsigned stack_of(void (*call)(void));
void reset(void);
extern unsigned char bss_begin[], bss_end[];

static void call_host(unsigned operation, const void *argument) {
  register unsigned r0 __asm__("r0") = operation;
  register const void *r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

void put_text(const char *text) { call_host(4, text); }

#ifndef STACK_TOP
#define STACK_TOP 0x20200000u
#define STACK_BYTES 0x8000u
#endif
#define PAINT 0xA5A5A5A5u

unsigned stack_used(void) { /* bytes, at most since reset */
  const uint32_t *p = (const uint32_t *)(STACK_TOP - STACK_BYTES);
  while (p < (const uint32_t *)STACK_TOP && *p == PAINT) p++;
  return STACK_TOP - (uint32_t)p;
}

unsigned stack_of(void (*call)(void)) { /* bytes, at most during the call */
  const uint32_t *p = (const uint32_t *)(STACK_TOP - STACK_BYTES);
  uint32_t here;
  __asm__ volatile("mov %0, sp" : "=r"(here));
  for (volatile uint32_t *q = (uint32_t *)(STACK_TOP - STACK_BYTES); q < (uint32_t *)here; q++) *q = PAINT;
  call();
  while (p < (const uint32_t *)here && *p == PAINT) p++;
  return here - (uint32_t)p;
}

void reset(void) {
  *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* CPACR: floating point */
  __asm__ volatile("dsb\n isb");
  for (volatile uint32_t *p = (uint32_t *)(STACK_TOP - STACK_BYTES); p < (uint32_t *)(STACK_TOP - 256u); p++) *p = PAINT;
  for (unsigned char *p = bss_begin; p < bss_end; p++) *p = 0;
  *(volatile uint32_t *)0xE000E014 = 0xFFFFFF; /* SysTick: reload, clear, processor clock and on */
  *(volatile uint32_t *)0xE000E018 = 0;
  *(volatile uint32_t *)0xE000E010 = 5;
  main();
  call_host(0x18, (const void *)0x20026);
  for (;;) {}
}

__attribute__((section(".vectors"), used)) static const struct {
  uint32_t stack;
  void (*begin[15])(void);
} vectors = {STACK_TOP, {reset}};
