"""Further measurements beside the readings: the balance of the momentum, and the angle between sun and nadir."""
