"""The attitude as physics: rigid body with wheels, torques and control, flown by a compiled kernel."""
