"""What is run: scenarios, supervisor, simulation, studies, recorder and monitor. May import everything."""
