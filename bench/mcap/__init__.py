"""The MCAP container, whole or damaged: writing chunks, walking records, summary, recovery. It knows no bus."""
