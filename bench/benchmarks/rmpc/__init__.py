"""The robust MPC's benchmark: one published set of problems, solved by the bench's own solver and by others."""
