"""The tightly coupled navigator: as long as one satellite is heard its range helps."""
