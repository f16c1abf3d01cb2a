"""Coverage control: the capacity of a sensor, its power cell, and the control laws that drive its body."""
