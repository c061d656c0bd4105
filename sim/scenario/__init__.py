"""The sections of a scenario: text to records and back, no physics."""
