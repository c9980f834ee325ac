"""What can go wrong in a run: the kinds of faults, and the plan that tells each node which are at work in a cycle."""
