"""The same drives for pyins and for this package, and what both find in the same terms.

pyins counts north, east, down and forward, right, down, in degrees where a table holds angles.
"""
