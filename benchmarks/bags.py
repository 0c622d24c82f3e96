"""Speed of reading, writing and correcting bags, each as a ratio of CPU times that are measured in turn in one run.

Run ``python benchmarks/bags.py``; ``--large`` measures the peak memory with a bag of 1 GB too, for which it needs 5 GB
of disk. What is compared with is rosbags: opening a bag and iterating its raw messages; deserialising each of them too;
making, serialising and writing a message after another.
"""

import tempfile
from pathlib import Path

import click
from bag_commands import hour, memory
from bag_reading import reading
from bag_writing import writing
from spread import show


@click.command(help=__doc__)
@click.option("--samples", default=30_000, show_default=True, help="Samples of four sensors and a scalar.")
@click.option("--repeats", default=5, show_default=True, help="How often each is measured.")
@click.option("--large", is_flag=True, help="Measure the peak memory with a bag of 1 GB.")
def main(samples: int, repeats: int, large: bool) -> None:
    """Run the benchmark."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = [*reading(folder, samples, repeats), *writing(folder, samples, repeats), *hour(folder, min(repeats, 3))]
        if large:
            rows += memory(folder)
    options = f"--samples {samples} --repeats {repeats}" + (" --large" if large else "")
    show("Bags", f"python benchmarks/bags.py {options}", "bags.csv", rows)


if __name__ == "__main__":
    main()
