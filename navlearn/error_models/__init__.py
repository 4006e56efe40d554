"""Error models: what is learned about the part a filter leaves."""
