"""The paper's own numbers, for the rows that stand beside ours: other shapes, another machine."""

from __future__ import annotations

Row = dict[str, float]
"""By column: E_MDD "mdd", E_angle "angle" (degrees), E_Exp "exp", seconds "log_time" ..."""

TABLE_1: dict[str, dict[str, Row]] = {
    "ShapeNet": {
        "heat": {"mdd": 0.250, "angle": 16.7, "log_time": 0.178},
        "tracing": {"exp": 0.036, "exp_time": 0.396},
        "projection": {
            "mdd": 0.115, "angle": 14.6, "log_time": 0.001, "exp": 0.049, "exp_time": 0.003
        },
        "paper": {
            "mdd": 0.110, "angle": 11.1, "log_time": 0.012, "exp": 0.026, "exp_time": 0.019
        },
    },
    "RawShapeNet": {
        "heat": {"mdd": 0.314, "angle": 21.3, "log_time": 0.101},
        "tracing": {"exp": 0.050, "exp_time": 0.374},
        "projection": {
            "mdd": 0.166, "angle": 17.1, "log_time": 0.001, "exp": 0.048, "exp_time": 0.003
        },
        "paper": {
            "mdd": 0.169, "angle": 15.4, "log_time": 0.013, "exp": 0.036, "exp_time": 0.020
        },
    },
    "Non-uniform": {
        "heat": {"mdd": 0.339, "angle": 22.4, "log_time": 0.051},
        "tracing": {"exp": 0.043, "exp_time": 0.415},
        "projection": {
            "mdd": 0.155, "angle": 16.3, "log_time": 0.0005, "exp": 0.047, "exp_time": 0.003
        },
        "paper": {
            "mdd": 0.152, "angle": 14.0, "log_time": 0.011, "exp": 0.030, "exp_time": 0.019
        },
    },
    "Noisy": {
        "heat": {"mdd": 0.326, "angle": 21.1, "log_time": 0.101},
        "tracing": {"exp": 0.060, "exp_time": 0.374},
        "projection": {
            "mdd": 0.203, "angle": 19.4, "log_time": 0.001, "exp": 0.055, "exp_time": 0.003
        },
        "paper": {
            "mdd": 0.202, "angle": 17.8, "log_time": 0.013, "exp": 0.038, "exp_time": 0.020
        },
    },
}  # fmt: skip
TABLE_2: dict[str, dict[str, Row]] = {
    "DFAUST": {
        "heat": {"mdd": 0.23, "angle": 25.47},
        "tracing": {"exp": 0.033},
        "projection": {"mdd": 0.17, "angle": 19.04, "exp": 0.071},
        "paper": {"mdd": 0.17, "angle": 16.51, "exp": 0.043},
    },
    "Kinect-v2": {
        "heat": {"mdd": 0.12, "angle": 8.45},
        "tracing": {"exp": 0.063},
        "projection": {"mdd": 0.11, "angle": 9.29, "exp": 0.064},
        "paper": {"mdd": 0.11, "angle": 8.37, "exp": 0.060},
    },
}
TABLE_3: dict[str, Row] = {
    "no_filtering": {"mdd": 0.112, "angle": 11.3, "exp": 0.027, "cost": 1.42},
    "simple_loss": {"mdd": 0.162, "angle": 11.5, "exp": 0.025, "cost": 1.0},
    "full": {"mdd": 0.112, "angle": 11.2, "exp": 0.028, "cost": 1.0},
}
TABLE_4: Row = {
    "exp_zero": 0.002,
    "exp_differential": 0.133,
    "log_zero": 0.004,
    "log_differential": 0.149,
}
TABLE_5: dict[str, Row] = {
    "octree_triplane": {"mdd": 0.11, "angle": 11.1, "exp": 0.026},
    "pointnet_triplane": {"mdd": 0.31, "angle": 29.2, "exp": 0.056},
    "octree_siren": {"mdd": 0.13, "angle": 14.3, "exp": 0.031},
}
COUNTERPART = {
    "manmade": ("ShapeNet", TABLE_1),
    "raw": ("RawShapeNet", TABLE_1),
    "nonuniform": ("Non-uniform", TABLE_1),
    "noisy": ("Noisy", TABLE_1),
    "humans": ("DFAUST", TABLE_2),
    "scans": ("Kinect-v2", TABLE_2),
}
"""The paper's category nearest to a group of ours."""
