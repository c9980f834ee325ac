"""Fault injection: the kinds of faults, and the plan from which each node gets the faults active in a cycle."""
