"""The tightly coupled filter: ranges and range rates of single satellites correct a vehicle."""
