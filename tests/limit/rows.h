/* Sixteen numbers at a time: one per hidden unit of a network, per lane of a block, or per node of a stretch of the map. */
#pragma once
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { WIDTH = 16 };
typedef float Row __attribute__((vector_size(4 * WIDTH)));
typedef int32_t IntRow __attribute__((vector_size(4 * WIDTH)));
typedef uint32_t BitRow __attribute__((vector_size(4 * WIDTH)));

static inline Row row_of(float x) { return x - (Row){0}; }

/* C has no choice between vectors; of these loops the compiler makes one instruction each. */
static inline Row row_min(Row a, Row b) {
  Row least;
  for (int i = 0; i < WIDTH; i++) least[i] = a[i] < b[i] ? a[i] : b[i];
  return least;
}

static inline Row row_max(Row a, Row b) {
  Row most;
  for (int i = 0; i < WIDTH; i++) most[i] = a[i] > b[i] ? a[i] : b[i];
  return most;
}

static inline Row row_where(IntRow is, Row a, Row b) { return (Row)((is & (IntRow)a) | (~is & (IntRow)b)); }

static inline float row_sum(Row x) {
  float sum = 0;
  for (int i = 0; i < WIDTH; i++) sum += x[i];
  return sum;
}

static inline float row_least(Row x) {
  float least = x[0];
  for (int i = 1; i < WIDTH; i++) least = x[i] < least ? x[i] : least;
  return least;
}

static inline Row row_sqrt(Row x) {
  Row root;
  for (int i = 0; i < WIDTH; i++) root[i] = sqrtf(x[i]);
  return root;
}

/* The quotient of two polynomials with which XLA and Eigen compute tanh in single precision. */
static inline Row row_tanh(Row x) {
  x = row_min(row_max(x, row_of(-7.9053111f)), row_of(7.9053111f));
  Row square = x * x;
  Row over = row_of(-2.76076847742355e-16f);
  over = over * square + 2.00018790482477e-13f;
  over = over * square - 8.60467152213735e-11f;
  over = over * square + 5.12229709037114e-08f;
  over = over * square + 1.48572235717979e-05f;
  over = over * square + 6.37261928875436e-04f;
  over = over * square + 4.89352455891786e-03f;
  Row under = row_of(1.19825839466702e-06f);
  under = under * square + 1.18534705686654e-04f;
  under = under * square + 2.26843463243900e-03f;
  under = under * square + 4.89352518554385e-03f;
  return x * over / under;
}

/* Sine and cosine: x less the nearest multiple k of pi / 2, then the two short series of Cephes' sinf and cosf. */
static inline void row_sincos(Row x, Row *sine, Row *cosine) {
  Row turns = x * 0.636619772f, whole;
  for (int i = 0; i < WIDTH; i++) whole[i] = rintf(turns[i]);
  IntRow k = __builtin_convertvector(whole, IntRow);
  Row rest = x - whole * 1.57079637f + whole * 4.37113883e-8f;
  Row square = rest * rest;
  Row s = rest + rest * square * (-1.6666654611e-1f + square * (8.3321608736e-3f - square * 1.9515295891e-4f));
  Row c = 1.0f - 0.5f * square + square * square * (4.166664568e-2f + square * (-1.388731625e-3f + square * 2.443315712e-5f));
  IntRow odd = (k & 1) != 0;
  Row first = row_where(odd, c, s), second = row_where(odd, s, c);
  *sine = row_where((k & 2) != 0, -first, first);
  *cosine = row_where(((k + 1) & 2) != 0, -second, second);
}

static inline Row row_sin(Row x) {
  Row sine, cosine;
  row_sincos(x, &sine, &cosine);
  return sine;
}

static inline Row row_cos(Row x) {
  Row sine, cosine;
  row_sincos(x, &sine, &cosine);
  return cosine;
}
