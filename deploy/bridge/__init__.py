"""A body whose robot speaks ROS 2, written from docs/reference/protocol.md alone: nothing of Covey's is imported here but this folder."""
