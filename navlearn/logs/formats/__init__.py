"""Readers, one small file per published format."""
