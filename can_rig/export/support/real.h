/* Real numbers of the control law: {words} precision, and what C leaves open about them.
 *
 * The law was designed and tested with IEEE 754 arithmetic that rounds after every operation. A
 * compiler must neither reorder operations, with -ffast-math and its parts, nor fuse operations, as
 * rounding.h says. self_test.h finds out a compiler that does.
 */
#ifndef REAL_H
#define REAL_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ != 0) || \
    defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "the control law needs IEEE 754 arithmetic: compile without -ffast-math and its parts"
#endif
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16
#error "the control law must be rounded after every operation: FLT_EVAL_METHOD must be 0 or 16"
#endif

typedef {real} real;

/* Neither infinite nor not-a-number. */
static inline bool real_is_finite(real x)
{
    return {fabs}(x) <= {MAX};
}

/* The smaller one; a, where they are equal or one of them is not-a-number. */
static inline real real_min(real a, real b)
{
    return b < a ? b : a;
}

/* The larger one; a, where they are equal or one of them is not-a-number. */
static inline real real_max(real a, real b)
{
    return b > a ? b : a;
}

/* The magnitude of one number with the sign of another. */
static inline real real_copysign(real magnitude, real sign)
{
    return signbit(sign) ? -{fabs}(magnitude) : {fabs}(magnitude);
}

static inline int32_t int_min(int32_t a, int32_t b)
{
    return b < a ? b : a;
}

static inline int32_t int_max(int32_t a, int32_t b)
{
    return b > a ? b : a;
}

/* What a divided by b leaves, with the sign of b. */
static inline int32_t int_modulo(int32_t a, int32_t b)
{
    const int32_t left = a % b;
    return left != 0 && (left < 0) != (b < 0) ? left + b : left;
}

#endif
