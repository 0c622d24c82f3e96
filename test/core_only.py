"""A Python that has the core only: what a process runs before it may import the package."""

CORE_ONLY = """
import sys


class Absent:
    "Refuses what Ubuntu 24.04 or a robot has not."

    names = {
        "apsw", "dask", "distributed", "jinja2", "lz4", "magpylib", "matplotlib", "pandas", "ppigrf", "pyarrow",
        "pydantic", "pymavlink", "pyulog", "rosbags", "xarray", "zstandard",
    }

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Absent())
"""
