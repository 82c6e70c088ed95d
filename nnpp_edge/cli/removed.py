"""Options that were removed, and what to write instead. Kept for one release."""

_SET = (
    *("clearance_m", "max_tilt_deg", "max_pitch_deg", "max_roll_deg", "max_step_m", "wheelbase_m", "track_m"),
    *("wheel_length_m", "wheel_width_m", "turning_radius_m", "radius_m"),
)
_LIMITS = (
    *("slope_limit_deg", "roughness_limit_m", "step_limit_m"),
    *("hard_slope_deg", "hard_roughness_m", "hard_step_m"),
)
_REPORT = "-o DIR writes all of a run"
_CORRIDOR = "Eq. 1's price is the only one"
_CORRIDOR_OF_A_VEHICLE = "no network is trained for a vehicle; plan with --method corridor"
_EXCLUDE = "ranges are minimum and maximum, weights have 7 bits; --exclude NODE,… leaves nodes float"


def _option(key: str) -> str:
    """The option that set a key: its name without the unit."""
    return f"--{key.rpartition('_')[0].replace('_', '-')}"


INSTEAD = {
    **{_option(key): f"write --set {key}=VALUE" for key in _SET},
    **{_option(key): f"write --limit {key}=VALUE" for key in _LIMITS},
    "--vehicle-length": "write --set length_m=VALUE",
    "--vehicle-width": "write --set width_m=VALUE",
    "--axles": "write --set axles=VALUE",
    "--gravity": "write --set mobility.energy.gravity_m_s2=VALUE",
    **{f"--{key}": f"write --loop {key}=VALUE" for key in ("cores", "priority", "approach")},
    "run --tolerance": "write --loop tolerance=VALUE",
    "run --refine": "write --loop refine=any-angle",
    "--metrics-port": "write --metrics PORT",
    "--metrics-file": "write --metrics PORT; status messages and --log have the counters too",
    "--unknown-passes": "write --set unknown_passes=true",
    "--unknown-fails": "write --set unknown_passes=false",
    "--framing": "each message is a line, which its base64 does not break",
    "--allow-vrt": "gdal_translate -of COG makes a GeoTIFF of a VRT",
    "reach --format": "`ogr2ogr reach.gpkg reach.geojson` makes a GeoPackage",
    "simulate --survey": "write --known FACTOR",
    "dataset --shard": "--scheduler shares the work out by Dask",
    "--vertical-scale": "`gdal_translate -a_scale METRES dem.png dem.tif` makes a GeoTIFF with that scale",
    "--landmarks": "they pay for many queries on one map: `Planner.prepare`",
    "--start-xy": "write --start xy:X,Y",
    "--goal-xy": "write --goal xy:X,Y",
    "--price": _CORRIDOR,
    "--prices": f"{_CORRIDOR}; write --methods astar,corridor",
    "--widths": "each corridor is measured as wide as `plan` searches it",
    **dict.fromkeys(("--html", "--board-row"), _REPORT),
    **dict.fromkeys(("profile --trace", "run --trace"), "the report has the time by stage, --log every answer's"),
    "evaluate --dataset": "write --terrain FILE; quantize --validation judges a model by a data set",
    "evaluate --rocks": "write --workload body-rocksN, with a vehicle",
    "--queries-per-map": "with a vehicle each answer is that of a planner that has checked no pose",
    "profile --limit": "a planner that needs more than 5 s for a query is left out",
    "--save-choice": "`auto` goes by the shipped figures; name another --method where you measured otherwise",
    **dict.fromkeys(("--poses", "dataset --vehicle", "dataset --mobility"), _CORRIDOR_OF_A_VEHICLE),
    "costmap --picture": "the picture lies beside the output, under its name",
    "dataset --picture": "samples are arrays for NumPy (docs/dataset.md)",
    "reproduce --dataset": "no experiment trains a network any more",
    "reproduce --steps": "no experiment trains a network any more",
    "train --encoding": "each architecture has one way of showing start and goal",
    "evaluate --plot": "the tables have gap and time of every planner; --json gives them to a plotting program",
    "--profile-plot": "`view` draws height and cost along the path, path.csv has them",
    "--loss": "the loss is binary cross-entropy; `nnpp_edge.training` takes another",
    "--opset": "files have opset 18",
    **dict.fromkeys(("quantize --method", "--full-range", "--rank"), _EXCLUDE),
}
"""Advice by the option; with its command where others have an option of that name."""


def instead_of(option: str, command: str) -> str | None:
    """Advice in place of a removed option of a command; None for one that never was."""
    told = INSTEAD.get(option) or INSTEAD.get(f"{command} {option}")
    return _CORRIDOR_OF_A_VEHICLE if command == "dataset" and told and "--set" in told else told
