/* A network of one hidden layer of tanh units, a row of weights per input, one per output, and a step of its gradient. */
#pragma once
#include "rows.h"

enum { MOST_INPUTS = 8, MOST_OUTPUTS = 4 };
typedef struct {
  Row in[MOST_INPUTS + 1]; /* the last used row is the bias; units that the network has not are zero */
  Row out[MOST_OUTPUTS];
  float bias[MOST_OUTPUTS];
} Network;

static inline __attribute__((always_inline)) Row hidden_of(const Network *net, int inputs, const float *x) {
  Row sum = net->in[inputs];
#pragma GCC unroll 8
  for (int i = 0; i < inputs; i++) sum += net->in[i] * x[i];
  return row_tanh(sum);
}

static inline __attribute__((always_inline)) void outputs_of(const Network *net, int outputs, Row hidden, float *y) {
#pragma GCC unroll 4
  for (int o = 0; o < outputs; o++) y[o] = row_sum(net->out[o] * hidden) + net->bias[o];
}

/* Moves the outputs towards a target: `error` is what they lack, times the slope of what stands behind them. */
static inline __attribute__((always_inline)) void descend(
    Network *net, int inputs, int outputs, const float *x, Row hidden, const float *error, float rate) {
  Row back = {0};
#pragma GCC unroll 4
  for (int o = 0; o < outputs; o++) {
    back += net->out[o] * error[o];
    net->out[o] += hidden * (rate * error[o]);
    net->bias[o] += rate * error[o];
  }
  back *= (1.0f - hidden * hidden) * rate;
#pragma GCC unroll 8
  for (int i = 0; i < inputs; i++) net->in[i] += back * x[i];
  net->in[inputs] += back;
}
