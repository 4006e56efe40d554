"""Outages: placing, replaying, judging and reporting them."""
