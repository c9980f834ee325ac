"""Evaluation of a run for people: metrics, figures, the report."""
