"""The telemetry record, its columns, and the files that it is read from and written to."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    record="Telemetry concatenate",
    quantities="QUANTITIES",
    telemetry_files="read_telemetry write_telemetry",
    column_map="load_column_map ColumnMap",
)
