/* The training step of ICAC (Algorithm 2) by hand: what a step of a lane costs where nothing stands between it and the
   processor. Blocks of sixteen lanes share random numbers and the arm's arithmetic; networks and map go lane by lane,
   over hidden units and nodes. `task.h` and `arm.h` are written from the package's own settings and arithmetic.

   step LANES WARM THREADS STEPS: trains WARM steps, prints statistics of the last tenth of them in a line of JSON, then
   answers each line of standard input with the nanoseconds of STEPS more steps. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "arm.h"
#include "itm.h"
#include "network.h"
#include "predictors.h"
#include "random.h"

typedef struct {
  Network actor, critic;
  float variance;
  Itm map;
  Predictor *predictors;
  float joints[JOINTS], velocity[JOINTS], goal[3], seen[OBSERVED];
  float totals[4];
  int episode, steps, age; /* steps of the episode, and of all episodes */
  uint32_t noise_key[2], start_key[2];
  bool failed;
} Lane;

typedef struct {
  float totals[4];
  int episode, steps, nodes;
  bool done, reached;
} Record;

typedef struct {
  double steps, updates, updated, nodes, ended, reached;
} Counts;

static void observe(Lane *lane) {
  for (int j = 0; j < JOINTS; j++) lane->seen[j] = 2 * (lane->joints[j] - LOW[j]) / (HIGH[j] - LOW[j]) - 1;
  for (int g = 0; g < 3; g++) lane->seen[JOINTS + g] = 2 * (lane->goal[g] - GOAL_LOW[g]) / (GOAL_HIGH[g] - GOAL_LOW[g]) - 1;
}

static void start_episode(Lane *lane) {
  Pair key = folded((Pair){(BitRow){0} + lane->start_key[0], (BitRow){0} + lane->start_key[1]}, (BitRow){0} + (uint32_t)lane->episode);
  Row goal_joints[JOINTS], tip[3];
  for (int j = 0; j < JOINTS; j++) {
    float middle = (LOW[j] + HIGH[j]) / 2, extent = RESET_RANGE * (HIGH[j] - LOW[j]);
    lane->joints[j] = middle + extent * (uniform(key, j)[0] - 0.5f);
    goal_joints[j] = row_of(middle + extent * (uniform(key, JOINTS + j)[0] - 0.5f));
    lane->velocity[j] = 0;
  }
  tip_of(goal_joints, tip);
  for (int g = 0; g < 3; g++) lane->goal[g] = tip[g][0];
  lane->steps = 0;
  memset(lane->totals, 0, sizeof lane->totals);
  observe(lane);
}

static float next_weight(uint64_t *state) { /* Knuth's generator is enough for weights */
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (float)(*state >> 40) / (1 << 23) - 1;
}

static void random_network(Network *net, int inputs, int outputs, uint64_t *state) {
  memset(net, 0, sizeof *net);
  for (int i = 0; i <= inputs; i++)
    for (int h = 0; h < UNITS; h++) net->in[i][h] = WEIGHT_SCALE * next_weight(state);
  for (int o = 0; o < outputs; o++) {
    for (int h = 0; h < UNITS; h++) net->out[o][h] = WEIGHT_SCALE * next_weight(state);
    net->bias[o] = WEIGHT_SCALE * next_weight(state);
  }
}

static void start_lane(Lane *lane, int seed) {
  uint64_t state = 0x9E3779B97F4A7C15u * (seed + 1);
  memset(lane, 0, sizeof *lane);
  random_network(&lane->actor, OBSERVED, JOINTS, &state);
  random_network(&lane->critic, OBSERVED, 1, &state);
  lane->variance = 1;
  float first[2][SENSED];
  for (int d = 0; d < 2 * SENSED; d++) first[d / SENSED][d % SENSED] = next_weight(&state);
  itm_init(&lane->map, first[0], first[1]);
  lane->predictors = aligned_alloc(64, sizeof(Predictor) * CAPACITY);
  memset(lane->predictors, 0, sizeof(Predictor) * CAPACITY);
  for (int n = 0; n < CAPACITY; n++) {
    random_network(&lane->predictors[n].fresh, PREDICTED_FROM, SENSED, &state);
    lane->predictors[n].net = lane->predictors[n].fresh;
  }
  for (int k = 0; k < 2; k++) {
    lane->noise_key[k] = (uint32_t)(state >> 32) + k;
    lane->start_key[k] = (uint32_t)state + k;
  }
  start_episode(lane);
}

/* Where the arms of a block go: `action` in units of the bound, for JOINTS rows of lanes. */
static void move(Row *joints, Row *velocity, const Row *action) {
  Row target[JOINTS];
  for (int j = 0; j < JOINTS; j++)
    target[j] = row_min(row_max(joints[j] + ACTION_BOUND * action[j], row_of(LOW[j])), row_of(HIGH[j]));
#if SERVO
  for (int s = 0; s < SUB_STEPS; s++) {
    Row now[3 * JOINTS], next[2 * JOINTS];
    memcpy(now, joints, sizeof target);
    memcpy(now + JOINTS, velocity, sizeof target);
    memcpy(now + 2 * JOINTS, target, sizeof target);
    physics_step(now, next);
    memcpy(joints, next, sizeof target);
    memcpy(velocity, next + JOINTS, sizeof target);
  }
  for (int j = 0; j < JOINTS; j++) {
    Row stopped = row_min(row_max(joints[j], row_of(LOW[j])), row_of(HIGH[j]));
    velocity[j] = row_where(stopped == joints[j], velocity[j], row_of(0));
    joints[j] = stopped;
  }
#else
  (void)velocity;
  memcpy(joints, target, sizeof target);
#endif
}

/* What a lane learns from a step. Returns how often its actor moved. */
static int learn(Lane *lane, const float *before, const float *action, Row hidden, bool reached) {
  float distance, value[1], next_value[1], in[PREDICTED_FROM];
  bool created;
  int node = itm_update(&lane->map, before, &distance, &created); /* line 8 */
  memcpy(in, before, sizeof(float) * SENSED);
  memcpy(in + SENSED, action, sizeof(float) * JOINTS);
  float progress = predict(&lane->predictors[node], created, in, lane->seen);
  float intrinsic = progress + distance, extrinsic = reached ? GOAL_REWARD : 0; /* Eq. 10, 11 */
  outputs_of(&lane->critic, 1, hidden_of(&lane->critic, OBSERVED, lane->seen), next_value);
  Row known = hidden_of(&lane->critic, OBSERVED, before);
  outputs_of(&lane->critic, 1, known, value);
  float td_error = intrinsic + extrinsic + GAMMA * next_value[0] - value[0]; /* lines 11, 13 */
  descend(&lane->critic, OBSERVED, 1, before, known, &td_error, CRITIC_RATE); /* Eq. 3 */
  lane->variance = (1 - BETA) * lane->variance + BETA * td_error * td_error;  /* Eq. 6 */
  int updates = td_error > 0 ? (int)ceilf(td_error / sqrtf(lane->variance)) : 0; /* Eq. 7 */
  if (updates > MOST_UPDATES) updates = MOST_UPDATES;
  for (int k = 0; k < updates; k++) {
    float y[JOINTS], lacks[JOINTS];
    if (k) hidden = hidden_of(&lane->actor, OBSERVED, before);
    outputs_of(&lane->actor, JOINTS, hidden, y);
    for (int j = 0; j < JOINTS; j++) lacks[j] = action[j] - y[j];
    descend(&lane->actor, OBSERVED, JOINTS, before, hidden, lacks, ACTOR_RATE); /* Eq. 5 */
  }
  const float parts[4] = {extrinsic, intrinsic, progress, distance};
  for (int k = 0; k < 4; k++) lane->totals[k] += parts[k];
  uint32_t bits;
  float sum = td_error + lane->variance;
  memcpy(&bits, &sum, sizeof bits);
  lane->failed |= (bits & 0x7F800000u) == 0x7F800000u;
  return updates;
}

static void step_block(Lane *lanes, int number, Record *records, Counts *counts) {
  Pair key = {{0}, {0}};
  BitRow age = {0};
  for (int i = 0; i < number; i++) {
    key.a[i] = lanes[i].noise_key[0];
    key.b[i] = lanes[i].noise_key[1];
    age[i] = (uint32_t)lanes[i].age;
  }
  Pair now = folded(key, age);
  Row action[JOINTS], joints[JOINTS] = {{0}}, velocity[JOINTS] = {{0}}, tip[3], hidden[WIDTH], away = {0}, goal[3] = {{0}};
  for (int j = 0; j < JOINTS; j++) action[j] = SIGMA * normal(now, j);
  for (int i = 0; i < number; i++) {
    float y[JOINTS];
    hidden[i] = hidden_of(&lanes[i].actor, OBSERVED, lanes[i].seen);
    outputs_of(&lanes[i].actor, JOINTS, hidden[i], y);
    for (int j = 0; j < JOINTS; j++) {
      action[j][i] += y[j];
      joints[j][i] = lanes[i].joints[j];
      velocity[j][i] = lanes[i].velocity[j];
    }
    for (int g = 0; g < 3; g++) goal[g][i] = lanes[i].goal[g];
  }
  for (int j = 0; j < JOINTS; j++) action[j] = row_min(row_max(action[j], row_of(-1)), row_of(1));
  move(joints, velocity, action);
  tip_of(joints, tip);
  for (int g = 0; g < 3; g++) away += (tip[g] - goal[g]) * (tip[g] - goal[g]);
  for (int i = 0; i < number; i++) {
    Lane *lane = &lanes[i];
    float before[OBSERVED], taken[JOINTS];
    memcpy(before, lane->seen, sizeof before);
    for (int j = 0; j < JOINTS; j++) {
      lane->joints[j] = joints[j][i];
      lane->velocity[j] = velocity[j][i];
      taken[j] = action[j][i];
    }
    observe(lane);
    lane->steps++;
    lane->age++;
    bool reached = away[i] <= GOAL_RADIUS * GOAL_RADIUS, done = reached || lane->steps >= HORIZON;
    int updates = learn(lane, before, taken, hidden[i], reached);
    Record record = {.episode = lane->episode, .steps = lane->steps, .nodes = lane->map.nodes, .done = done, .reached = reached};
    memcpy(record.totals, lane->totals, sizeof record.totals);
    records[i] = record;
    counts->steps++;
    counts->updates += updates;
    counts->updated += updates > 0;
    counts->nodes += lane->map.nodes;
    counts->ended += done;
    counts->reached += reached;
    if (done) {
      lane->episode++;
      start_episode(lane);
    }
  }
}

typedef struct {
  Lane *lanes;
  Record *records;
  int number, steps;
  Counts counts;
} Share;

static void *run(void *given) {
  Share *share = given;
  share->counts = (Counts){0};
  for (int s = 0; s < share->steps; s++)
    for (int first = 0; first < share->number; first += WIDTH) {
      int number = share->number - first < WIDTH ? share->number - first : WIDTH;
      step_block(share->lanes + first, number, share->records + (size_t)(s % 500) * share->number + first, &share->counts);
    }
  return 0;
}

static Counts run_all(Share *shares, int threads, int steps) {
  pthread_t started[64];
  Counts sum = {0};
  for (int t = 0; t < threads; t++) shares[t].steps = steps;
  for (int t = 1; t < threads; t++) pthread_create(&started[t], 0, run, &shares[t]);
  run(&shares[0]);
  for (int t = 1; t < threads; t++) pthread_join(started[t], 0);
  for (int t = 0; t < threads; t++)
    for (int k = 0; k < (int)(sizeof(Counts) / sizeof(double)); k++) ((double *)&sum)[k] += ((double *)&shares[t].counts)[k];
  return sum;
}

int main(int arguments, char **values) {
  if (arguments != 5) return 2;
  int lanes = atoi(values[1]), warm = atoi(values[2]), threads = atoi(values[3]), steps = atoi(values[4]);
  Share shares[64];
  for (int t = 0, seed = 0; t < threads; t++) {
    int number = lanes / threads + (t < lanes % threads);
    shares[t] = (Share){.number = number};
    shares[t].lanes = aligned_alloc(64, sizeof(Lane) * (size_t)(number ? number : 1));
    shares[t].records = malloc(sizeof(Record) * 500 * (size_t)(number ? number : 1));
    for (int i = 0; i < number; i++) start_lane(&shares[t].lanes[i], seed++);
  }
  run_all(shares, threads, warm - warm / 10);
  Counts seen = run_all(shares, threads, warm / 10);
  printf("{\"updates\": %g, \"updated\": %g, \"nodes\": %g, \"ended\": %g, \"reached\": %g}\n", seen.updates / seen.steps,
         seen.updated / seen.steps, seen.nodes / seen.steps, seen.ended / seen.steps, seen.reached / seen.ended);
  fflush(stdout);
  char line[64];
  while (fgets(line, sizeof line, stdin)) {
    struct timespec began, ended;
    clock_gettime(CLOCK_MONOTONIC, &began);
    run_all(shares, threads, steps);
    clock_gettime(CLOCK_MONOTONIC, &ended);
    printf("%.0f\n", (ended.tv_sec - began.tv_sec) * 1e9 + (ended.tv_nsec - began.tv_nsec));
    fflush(stdout);
  }
  return 0;
}
