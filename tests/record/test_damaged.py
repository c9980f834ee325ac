"""Every command on damaged logs; `python -m tests.record.damage` tries 10,000 of them."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SEED = 1_000_000


def test_a_damaged_log_ends_in_a_clear_error_or_a_correct_part(tries):
    """In a process of its own, whose memory is limited."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.record.damage", str(tries(27, 200)), str(SEED), "1"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    ends = {
        end.strip(): int(times)
        for times, _, end in (line.strip().partition(" ") for line in done.stdout.splitlines())
        if times.isdecimal() and ": " in end
    }
    # Neither all refused nor all whole.
    assert all(ends[f"recover: exit code {code}"] >= 2 for code in (0, 2, 3)), ends
