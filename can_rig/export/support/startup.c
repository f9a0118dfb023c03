/* Start of a Cortex-M4F or M7 on QEMU's MPS2 boards: floating-point unit on, memory ready, main. */
#include <stdint.h>
#include <string.h>

#define CPACR (*(volatile uint32_t *)0xE000ED88u)

extern uint32_t stack_top;
extern uint8_t data_start, data_end, data_load, bss_start, bss_end;
int main(void);
void reset(void);
void fault(void);
void pend_sv(void);
void sys_tick(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top,    (void *)reset, (void *)fault, (void *)fault,
    (void *)fault, (void *)fault, (void *)fault,   [14] = (void *)pend_sv, (void *)sys_tick,
};

void fault(void)
{
    for (;;) {
    }
}

__attribute__((weak)) void pend_sv(void)
{
    fault();
}

__attribute__((weak)) void sys_tick(void)
{
    fault();
}

void reset(void)
{
    CPACR |= 0xFu << 20; /* full access to the floating-point unit */
    __asm__ volatile("dsb\n isb");
    memcpy(&data_start, &data_load, (uintptr_t)(&data_end - &data_start));
    memset(&bss_start, 0, (uintptr_t)(&bss_end - &bss_start));
    (void)main();
    fault();
}
