"""Runs an ECU again on its recorded inputs and compares its outputs with the recorded ones: `platoon resim`."""
