"""Whom an agent listens to that hears its neighbours only: tiles, positions of peers, selection, subscriptions."""
