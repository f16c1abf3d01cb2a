"""Who takes part: the table of peers, announcements, settings that must agree, and links that work one way only."""
