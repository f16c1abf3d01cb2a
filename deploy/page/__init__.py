"""The live page: a server that only subscribes, metrics for Prometheus, and one static page that works offline."""
