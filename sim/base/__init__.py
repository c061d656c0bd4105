"""What every other folder stands on: errors, checked TOML, the atomic writer, random streams, kernels."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    errors="FluxtwinError BadInput NoAnswer OutOfRange",
    random_streams="stream",
    files="write_text write_toml write_bytes",
)
