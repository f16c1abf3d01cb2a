"""The compiled twins of what a round computes, bit for bit the same, and the cache of compiled code on disk."""
