"""The peers of an agent: their table, announcements, settings that must agree, and detectors of half-open links."""
