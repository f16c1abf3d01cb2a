"""What is kept of a run: recordings, replay, re-scoring, exports, traces; and the observers that write them."""
