/* The instantaneous topological map (Algorithm 1, lines 1-14 and 19-21): work by nodes that live, edges as bits. */
#pragma once
#include <stdbool.h>
#include "task.h"

static const float FAR_AWAY = 1e18f; /* where slots without a node are: never the nearest */

typedef struct {
  Row weights[SENSED][CAPACITY / WIDTH];
  uint32_t edges[CAPACITY][CAPACITY / 32], live[CAPACITY / 32];
  int degree[CAPACITY];
  int nodes, top, overflow; /* `top` is one beyond the last slot in use */
} Itm;

static inline float weight(const Itm *map, int d, int slot) { return ((const float *)map->weights[d])[slot]; }
static inline void place(Itm *map, int slot, const float *x) {
  for (int d = 0; d < SENSED; d++) ((float *)map->weights[d])[slot] = x ? x[d] : FAR_AWAY;
}
static inline bool bit(const uint32_t *bits, int slot) { return bits[slot / 32] >> (slot % 32) & 1; }
static inline void put(uint32_t *bits, int slot) { bits[slot / 32] |= 1u << (slot % 32); }
static inline void clear(uint32_t *bits, int slot) { bits[slot / 32] &= ~(1u << (slot % 32)); }

static void itm_init(Itm *map, const float *first, const float *second) {
  memset(map, 0, sizeof *map);
  for (int slot = 0; slot < CAPACITY; slot++) place(map, slot, 0);
  place(map, 0, first);
  place(map, 1, second);
  put(map->edges[0], 1);
  put(map->edges[1], 0);
  map->degree[0] = map->degree[1] = 1;
  map->live[0] = 3;
  map->nodes = map->top = 2;
}

static void remove_node(Itm *map, int slot) {
  clear(map->live, slot);
  place(map, slot, 0);
  map->degree[slot] = 0;
  map->nodes--;
  while (!bit(map->live, map->top - 1)) map->top--;
}

static void unlink_nodes(Itm *map, int a, int b) {
  clear(map->edges[a], b);
  clear(map->edges[b], a);
  map->degree[a]--;
  map->degree[b]--;
}

static inline int slot_of(const Row *squares, int rows, float value) {
  for (int r = 0; r < rows; r++) {
    unsigned equal = 0;
    for (int i = 0; i < WIDTH; i++) equal |= (unsigned)(squares[r][i] == value) << i;
    if (equal) return r * WIDTH + __builtin_ctz(equal);
  }
  return 0;
}

static inline float least_of(const Row *squares, int rows) {
  Row least = squares[0];
  for (int r = 1; r < rows; r++) least = row_min(least, squares[r]);
  return row_least(least);
}

/* (a - c) . (b - c) */
static inline float corner(const float *a, const float *b, const float *c) {
  float sum = 0;
  for (int d = 0; d < SENSED; d++) sum += (a[d] - c[d]) * (b[d] - c[d]);
  return sum;
}

/* Adapts the map to a stimulus. Returns the node that is responsible for it, and whether it is new. */
static inline int itm_update(Itm *map, const float *x, float *distance, bool *created) {
  Row squares[CAPACITY / WIDTH];
  int rows = (map->top + WIDTH - 1) / WIDTH;
  for (int r = 0; r < rows; r++) { /* line 1 */
    Row sum = {0};
    for (int d = 0; d < SENSED; d++) sum += (map->weights[d][r] - x[d]) * (map->weights[d][r] - x[d]);
    squares[r] = sum;
  }
  float nearest = least_of(squares, rows);
  int n = slot_of(squares, rows, nearest);
  ((float *)squares)[n] = INFINITY;
  int second = slot_of(squares, rows, least_of(squares, rows));
  *distance = sqrtf(nearest);

  float w_n[SENSED], w_second[SENSED];
  for (int d = 0; d < SENSED; d++) { /* line 2 */
    w_n[d] = weight(map, d, n) + MAP_RATE * (x[d] - weight(map, d, n));
    w_second[d] = weight(map, d, second);
  }
  place(map, n, w_n);
  if (!bit(map->edges[n], second)) { /* line 3 */
    put(map->edges[n], second);
    put(map->edges[second], n);
    map->degree[n]++;
    map->degree[second]++;
  }
  for (int k = 0; k < CAPACITY / 32; k++) /* lines 4-8 */
    for (uint32_t left = map->edges[n][k]; left; left &= left - 1) {
      int m = 32 * k + __builtin_ctz(left);
      float w_m[SENSED];
      for (int d = 0; d < SENSED; d++) w_m[d] = weight(map, d, m);
      if (m != second && corner(w_n, w_m, w_second) < 0) {
        unlink_nodes(map, n, m);
        if (!map->degree[m]) remove_node(map, m);
      }
    }
  int node = n;
  *created = false;
  if (corner(x, x, w_n) > E_MAX * E_MAX && corner(w_n, w_second, x) > 0) { /* lines 12-14 */
    int free = 0;
    while (free < CAPACITY && bit(map->live, free)) free++;
    if (free == CAPACITY) {
      map->overflow++;
    } else {
      node = free;
      *created = true;
      put(map->live, free);
      place(map, free, x);
      memset(map->edges[free], 0, sizeof map->edges[free]);
      put(map->edges[n], free);
      put(map->edges[free], n);
      map->degree[free] = 1;
      map->degree[n]++;
      map->nodes++;
      if (free >= map->top) map->top = free + 1;
    }
  }
  if (corner(w_n, w_n, w_second) < E_MAX * E_MAX / 4 && map->nodes > 2) { /* lines 19-21 */
    for (int k = 0; k < CAPACITY / 32; k++)
      for (uint32_t left = map->edges[second][k]; left; left &= left - 1) unlink_nodes(map, second, 32 * k + __builtin_ctz(left));
    remove_node(map, second);
  }
  return node;
}
