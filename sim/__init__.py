"""The world and the spacecraft: time, frames, orbit, sun, field, attitude, sensors, telemetry, simulate."""

if __name__ == "sim":
    raise ImportError("import fluxtwin.sim, never the bare folder name: two copies of every class would exist")
