"""What is run: the command line, live swarms, simulations, faults, scores, recordings, the page and studies. May import all rooms."""
