/* Every operation of the functions that follow is rounded: a compiler must not fuse a multiplication
 * and an addition. gcc does so outside -std=c99 and ignores C's own pragma. self_test.h finds out
 * compilers that disregard the line for them.
 */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif
