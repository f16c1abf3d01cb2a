"""Where a sensor should be: its capacity, its power cell, and how its body is driven."""
