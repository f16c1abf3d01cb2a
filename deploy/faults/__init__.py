"""Faults: their verbs and schedule, links that fail, and the injector of simulations."""
