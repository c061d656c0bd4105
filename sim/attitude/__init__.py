"""Attitude and motion of a body, as far as an estimator may see them."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    record="Attitude Waypoint librating inertial_hold slews tumble spin",
    recorded_motion="RecordedMotion",
    rigid_body="torque_free principal_axes",
    smoothed_track="AttitudeTrack smoothed",
)
