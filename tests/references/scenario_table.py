"""The milling scenario's map of docs/method.md, from an independent prototype."""

NAMES = ("control_horizon", "prediction_horizon", "lambda_mpc", "lambda_kf")

# By values of these: E[C], worst overshoot, nominal C, feasible. The narrow optimum is the first.
TABLE = {
    (1, 4, -3.9, 2.0): (0.165, 0.089, 0.137, True),
    (1, 3, -3.9, 2.0): (0.140, 0.125, 0.109, False),
    (1, 5, -3.9, 2.0): (0.222, 0.055, 0.195, True),
    (2, 4, -3.9, 2.0): (0.247, 0.144, 0.204, False),
    (15, 15, -3.0, -1.0): (0.206, 0.146, 0.164, False),
    (5, 5, -2.0, -1.0): (0.144, 0.143, 0.109, False),
    (8, 8, -1.0, -1.0): (0.162, 0.096, 0.132, False),
    (8, 8, -0.75, -1.0): (0.174, 0.084, 0.145, True),
}
