"""A log's frames sent out again, with their timing."""
