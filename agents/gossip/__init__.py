"""What agents say to each other in a round: the messages that go out, those that were accepted, and their table."""
