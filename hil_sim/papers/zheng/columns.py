"""The table of samples that the actions of ``goldfield paper zheng`` read and write."""

SAMPLES = ("window", "t_s", "bx_T", "by_T", "bz_T")
"""Columns that a table of samples must have; a window is one standing place."""

COLUMNS_HELP = (
    f"CSV with the columns {','.join(SAMPLES)}[,x_m,y_m,z_m], one row a sample; a window is one standing place, its "
    "rows follow each other; t_s is on the beacons' clock. With a site file of boards the table of goldfield samples, "
    "a window a cycle"
)
