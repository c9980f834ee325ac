"""The bench's hot modules as machine code: the same Python files, compiled by Cython and the system's C compiler.

The files stay plain Python (Cython's pure Python mode): what is read, tested line by line and changed is what runs.
`finder` loads the machine code, but only if it was compiled from exactly the present sources; `build` makes it. Without
it, or with PLATOON_INTERPRETED=1, the same files are interpreted, with the same results and some fifty times as slow.
"""
