"""What runs and metrics are called in figures, tables and verdicts."""

# By the name of a run: an algorithm of the paper, or ICAC with one part changed.
RUNS = {
    "cacla": "CACLA",
    "cacla_var": "CACLA+Var",
    "icac": "ICAC",
    "icac-single_predictor": "ICAC, one predictor",
    "icac-learning_progress": "ICAC, learning progress alone",
    "icac-perception_error": "ICAC, perception error alone",
}
# Of `results.METRICS`.
METRICS = {
    "extrinsic_reward": "reward per episode",
    "success_rate": "success",
    "steps": "steps",
    "steps_when_reached": "steps when reached",
}
# Of `results.judged`.
JUDGED = METRICS | {"steps_all_episodes": "steps, all episodes", "steps_first_tenth": "steps, first tenth"}
