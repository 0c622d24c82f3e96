"""Installation with colcon (ament_python) and with pip."""

from glob import glob

from setuptools import find_packages, setup

NAME = "tam_calibration"
SHARE = f"share/{NAME}"
BAGS = ["apsw>=3.46", "rosbags>=0.11", "zstandard>=0.22", "lz4>=4.0"]
COMPARE = ["mujoco>=3.2"]
REPORT = ["jinja2>=3", "matplotlib>=3.6"]
FLEET = ["distributed>=2024.1", *REPORT]
VALIDATION = ["magpylib>=5", "ppigrf>=2", *REPORT]
NOTEBOOK = ["pandas>=2", "xarray>=2024.1"]
TABLES = ["pandas>=2", "pyarrow>=14"]
DOCS = ["myst-parser", "numpydoc", "sphinx>=7.2", "sphinx-rtd-theme"]

setup(
    name=NAME,
    version="0.1.0",
    description="Calibration of cross arrays of tri-axial magnetometers over ROS 2 and offline",
    maintainer="The tam_calibration maintainers",
    maintainer_email="maintainers@tam-calibration.org",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "effects/*.toml", "gap/laws/*.toml", "model/*.shc", "report/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", glob("launch/*.py")),
        (f"{SHARE}/config", glob("config/*.*")),
        (f"{SHARE}/config/scenarios", glob("config/scenarios/*.*")),
    ],
    zip_safe=False,
    python_requires=">=3.11",
    install_requires=["PyYAML>=6", "click>=8.1", "numpy>=1.26", "rich>=13", "scipy>=1.11"],
    extras_require={
        "bags": BAGS,
        "bench": ["circuitpython-mag-cal", "harmonica>=0.7", "magcal", "navlib>=2"],
        "compare": COMPARE,
        "docs": DOCS,
        "fleet": FLEET,
        "mutants": ["cosmic-ray>=8.7"],
        "notebook": NOTEBOOK,
        "report": REPORT,
        "tables": TABLES,
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy[fastrtps]"],
        "test": [
            "click>=8.2",
            "colcon-common-extensions",
            "hypothesis",
            "mypy",
            "pymavlink>=2.4.40",
            "pytest",
            "pytest-xdist",
            "pyulog>=1.0",
            "ruff",
            "types-PyYAML",
            *BAGS,
            *COMPARE,
            *DOCS,
            *FLEET,
            *NOTEBOOK,
            *TABLES,
            *VALIDATION,
        ],
        "validation": VALIDATION,
    },
    entry_points={
        "console_scripts": [
            f"tam = {NAME}.__main__:run",
            f"collector = {NAME}.nodes.start:collector",
            f"calibrator = {NAME}.nodes.start:calibrator",
            f"corrector = {NAME}.nodes.start:corrector",
            f"localizer = {NAME}.nodes.start:localizer",
            f"stream = {NAME}.nodes.start:stream",
        ],
        f"{NAME}.readers": [
            f"bag = {NAME}.recordings.bag_format:BagFormat",
            f"dataflash = {NAME}.recordings.dataflash_source:DataFlashReader",
            f"parquet = {NAME}.recordings.text_source:ParquetReader",
            f"ulog = {NAME}.recordings.ulog_source:UlogReader",
        ],
    },
)
