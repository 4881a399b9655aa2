/* A predictor per node and its learning progress (Algorithm 1, lines 15-17, Eq. 8-10): running sums, no window read. */
#pragma once
#include <stdbool.h>
#include "network.h"
#include "task.h"

enum { KEPT = 64, PREDICTED_FROM = SENSED + JOINTS }; /* errors kept: a power of two not less than MU + LAG */
typedef struct {
  Network net, fresh;
  float errors[KEPT];
  float now, then; /* sums of the newest MU errors, and of the MU before the newest LAG */
  int queries;
} Predictor;

/* Asks and trains a predictor; returns |<e_t> - <e_{t-T}>|. */
static inline float predict(Predictor *p, bool created, const float *in, const float *target) {
  if (created) {
    p->net = p->fresh;
    p->queries = 0;
    p->now = p->then = 0;
  }
  Row hidden = hidden_of(&p->net, PREDICTED_FROM, in);
  float y[MOST_OUTPUTS], lacks[MOST_OUTPUTS], squares = 0;
  outputs_of(&p->net, SENSED, hidden, y);
  Row last = {0};
  for (int d = 0; d < SENSED; d++) last[d] = y[d];
  last = row_tanh(last);
  for (int d = 0; d < SENSED; d++) {
    float gap = target[d] - last[d];
    squares += gap * gap;
    lacks[d] = gap * (1 - last[d] * last[d]);
  }
  descend(&p->net, PREDICTED_FROM, SENSED, in, hidden, lacks, PREDICTOR_RATE);
  float error = sqrtf(squares); /* Eq. 8 */
  int q = p->queries++;
  p->now += error - (q >= MU ? p->errors[(q - MU) % KEPT] : 0);
  if (q >= LAG) p->then += p->errors[(q - LAG) % KEPT] - (q >= MU + LAG ? p->errors[(q - MU - LAG) % KEPT] : 0);
  p->errors[q % KEPT] = error;
  q++;
  if (q <= LAG) return 0;
  float before = q - LAG;
  return fabsf(p->now / (q < MU ? q : MU) - p->then / (before < MU ? before : MU)); /* Eq. 9, 10 */
}
