"""The live page: a server that is a pure subscriber, and one static page that works offline."""
