/* Threefry-2x32 (Salmon 2011) as JAX has it, for a block of lanes at a time. */
#pragma once
#include "rows.h"

typedef struct {
  BitRow a, b;
} Pair;

static inline Pair threefry(Pair key, Pair count) {
  static const int turn[8] = {13, 15, 26, 6, 17, 29, 16, 24};
  BitRow keys[3] = {key.a, key.b, key.a ^ key.b ^ 0x1BD11BDAu};
  Pair x = {count.a + keys[0], count.b + keys[1]};
#pragma GCC unroll 5
  for (int group = 0; group < 5; group++) {
#pragma GCC unroll 4
    for (int i = 0; i < 4; i++) {
      int by = turn[4 * (group & 1) + i];
      x.a += x.b;
      x.b = (x.b << by) | (x.b >> (32 - by));
      x.b ^= x.a;
    }
    x.a += keys[(group + 1) % 3];
    x.b += keys[(group + 2) % 3] + (uint32_t)(group + 1);
  }
  return x;
}

/* The key of what happens at a step: the lane's own key, folded with a number. */
static inline Pair folded(Pair key, BitRow number) { return threefry(key, (Pair){(BitRow){0}, number}); }

/* Uniform in [0, 1), draw `place` of a key. */
static inline Row uniform(Pair key, uint32_t place) {
  Pair drawn = threefry(key, (Pair){(BitRow){0}, (BitRow){0} + place});
  BitRow bits = ((drawn.a ^ drawn.b) >> 9) | 0x3F800000u;
  Row one_to_two;
  memcpy(&one_to_two, &bits, sizeof bits);
  return one_to_two - 1.0f;
}

/* Normal, by the inverse of the error function (Giles 2012); both of its branches, so that it runs over lanes. */
static inline Row normal(Pair key, uint32_t place) {
  Row u = row_max(uniform(key, place) * 2.0f - 0.99999994f, row_of(-0.99999994f)), w;
  Row inside = (1.0f - u) * (1.0f + u);
  for (int i = 0; i < WIDTH; i++) w[i] = -logf(inside[i]);
  Row near = w - 2.5f, far = row_sqrt(w) - 3.0f;
  static const float middle[9] = {2.81022636e-08f, 3.43273939e-07f, -3.5233877e-06f, -4.39150654e-06f, 0.00021858087f,
                                  -0.00125372503f, -0.00417768164f, 0.246640727f, 1.50140941f};
  static const float tail[9] = {-0.000200214257f, 0.000100950558f, 0.00134934322f, -0.00367342844f, 0.00573950773f,
                                -0.0076224613f, 0.00943887047f, 1.00167406f, 2.83297682f};
  Row p = row_of(middle[0]), q = row_of(tail[0]);
#pragma GCC unroll 8
  for (int i = 1; i < 9; i++) {
    p = p * near + middle[i];
    q = q * far + tail[i];
  }
  return 1.41421356f * u * row_where(w < 5.0f, p, q);
}
