"""The compiled twins of the functions of a round, with equal bits, and the cache of compiled code on disk."""
