"""What is true: targets, bodies, detector and score. Imports protocol only; agents learn of it through messages alone."""
