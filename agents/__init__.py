"""What is believed and decided: one agent, its filter, its cell, its control. Imports protocol only."""
