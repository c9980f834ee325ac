"""Sends a log's frames again with their recorded timing."""
