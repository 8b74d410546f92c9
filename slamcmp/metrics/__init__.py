"""Accuracy, consistency and cost: plain functions in a registry."""

from slamcmp.metrics.tables import (
    MetricColumn,
    frame_table,
    landmark_table,
    metric_columns,
    reference_truth,
    score_run,
)

__all__ = [
    "score_run",
    "frame_table",
    "landmark_table",
    "reference_truth",
    "metric_columns",
    "MetricColumn",
]
