"""Which effects: score tests, refits, forward selection, by one criterion."""
