"""Make the screens, numbers and pictures of README and tutorials anew.

    python docs/screens.py             everything
    python docs/screens.py axis        the feed axis, in process: the first tutorial
    python docs/screens.py position    the position loop, over ROS: README and second tutorial

A document has ``<!-- screen: NAME -->`` ahead of each block that is made here. Chromium takes the
picture of the report; without it that one stays as it is.
"""

import argparse
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import yaml

from bo_tuner.storage.provenance import commit

ROOT = Path(__file__).resolve().parent.parent
DOCS, EXAMPLE = ROOT / "docs", ROOT / "examples" / "unchanged_system"
DOCUMENTS = (
    ROOT / "README.md",
    DOCS / "tutorial_first_run.md",
    DOCS / "tutorial_unchanged_system.md",
)
BLOCK = re.compile(
    r"<!-- screen: (?P<name>[\w-]+) -->\n(?:```text\n(?P<fenced>.*?)```\n|(?P<plain>.*?\n)(?=\n))",
    re.DOTALL,
)
COLUMNS = "100"
DOMAIN = "87"
"""Of the nodes of the position loop; with localhost discovery nobody else hears them."""
PICTURES = {
    "contexts.png": "axis_contexts.png",
    "contours.png": "axis_contours.png",
    "response.png": "axis_trajectories.png",
}
PAGE = "1280,860"
A_RESULT = (0, 3)


def main() -> None:
    """Run what is asked for, and write the documents."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help="axis, position (default: both)")
    parser.add_argument("--trials", default="30", help="of the feed axis (default: %(default)s)")
    parser.add_argument(
        "--output", type=Path, default=ROOT, help="a copy of the repository's documents"
    )
    arguments = parser.parse_args()
    parts = arguments.parts or ["axis", "position"]
    screens: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "axis" in parts:
            screens |= axis(folder, arguments.trials, arguments.output / "docs" / "images")
        if "position" in parts:
            screens |= position(folder, arguments.output / "docs" / "images")
    for document in DOCUMENTS:
        path = arguments.output / document.relative_to(ROOT)
        path.write_text(filled(path.read_text(encoding="utf-8"), screens), encoding="utf-8")


def filled(text: str, screens: Mapping[str, str]) -> str:
    """Return a document with its screens; one that is not among them stays as it is."""

    def put(match: re.Match[str]) -> str:
        group = "plain" if match["fenced"] is None else "fenced"
        start, end = (at - match.start() for at in match.span(group))
        return match[0][:start] + screens.get(match["name"], match[group]) + match[0][end:]

    return BLOCK.sub(put, text)


def names(text: str) -> list[str]:
    """Return the names of a document's screens."""
    return [match["name"] for match in BLOCK.finditer(text)]


def axis(folder: Path, trials: str, images: Path) -> dict[str, str]:
    """Tune, certify and look at the feed axis, in process and with a seed."""
    options = ("--backend", "inprocess", "--trials", trials, "--seed", "1")
    tuned = said(folder, "tune", *options)
    certified = said(folder, "validate", "runs/latest")
    said(folder, "report", "runs/latest", "--figures", "plots", "--format", "png")
    for made, shown in PICTURES.items():
        for path in folder.glob(f"**/{made}"):
            shutil.copy(path, images / shown)
    photograph(folder / "runs" / "latest" / "report.html", images / "report.png")
    rows, verdict = parted(tuned)
    command = " ".join(("tune", *options))
    return {
        "axis-origin": f"All outputs below are from `{command}`, then `validate`,\n"
        f"at commit {commit()} on {processor()}.\n",
        "axis-rows": shortened(rows),
        "axis-verdict": verdict,
        "axis-certificate": parted(certified)[1],
    }


def position(folder: Path, images: Path) -> dict[str, str]:
    """Tune the position loop beside its running nodes, and draw the first picture."""
    with running(*(EXAMPLE / name for name in ("motor_node.py", "pid_node.py"))):
        study = EXAMPLE / "study.yaml"
        tuned = said(
            folder,
            "tune",
            "--study",
            str(study),
            "--attach",
            "--record",
            "all",
            "--output",
            "position",
        )
    animation = (
        sys.executable,
        EXAMPLE / "animation.py",
        folder / "position" / "latest",
        images / "position.gif",
    )
    subprocess.run(animation, check=True)
    _, verdict = parted(tuned)
    gains = re.findall(r"(mean \w+) [\d.]+ → [\d.]+ \S.*?\((\S+ %)\)", verdict)
    trials = yaml.safe_load(study.read_text(encoding="utf-8"))["budget"]["trials"]
    told = ", ".join(f"{name} {change}" for name, change in gains)
    return {
        "position-gain": "*A [position loop](docs/tutorial_unchanged_system.md), neither node "
        f"changed: {trials} trials; {told}.*\n",
        "position-verdict": verdict,
    }


def said(folder: Path, command: str, *arguments: str) -> str:
    """Run a command of the tuner; returns what it says."""
    done = subprocess.run(
        [sys.executable, "-m", "bo_tuner", command, *arguments],
        cwd=folder,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode not in A_RESULT:
        sys.exit(f"error: {command} ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


def parted(text: str) -> tuple[str, str]:
    """Return the rows of a run's trials, and its verdict up to what comes next."""
    lines = [line.rstrip() for line in text.splitlines()]
    ends = [k for k, line in enumerate(lines) if line.startswith(("parameters: ", "next:"))]
    end = ends[0] if ends else len(lines)
    starts = [k for k, line in enumerate(lines[:end]) if line[:1].isupper()]
    start = starts[0] if starts else 0
    return "\n".join(lines[1:start]) + "\n", "\n".join(lines[start:end]) + "\n"


def shortened(rows: str) -> str:
    """Return the heading, the first two trials, and those that were the best so far first and last.

    A long run repeats its heading, and may have advice between its rows.
    """
    lines = rows.splitlines()
    trials = [k for k, line in enumerate(lines) if line.split()[:1] and line.split()[0].isdigit()]
    best = [k for k in trials if "best so far" in lines[k]]
    shown = sorted({*trials[:2], *best[:1], *best[-2:]})
    kept = lines[: trials[0]]
    for before, k in zip([None, *shown], shown, strict=False):
        if before is not None and trials.index(k) > trials.index(before) + 1:
            kept.append("  ...")
        kept.append(lines[k])
    return "\n".join(kept) + "\n"


@contextlib.contextmanager
def running(*programs: Path) -> Iterator[None]:
    """Run nodes meanwhile."""
    nodes = [subprocess.Popen([sys.executable, path], env=environment()) for path in programs]
    try:
        yield
    finally:
        for node in nodes:
            node.send_signal(signal.SIGINT)
        for node in nodes:
            try:
                node.wait(timeout=15.0)
            except subprocess.TimeoutExpired:
                node.kill()
                node.wait()


def environment() -> dict[str, str]:
    """Return the environment of commands and nodes: text of one width, a domain of their own."""
    mine = {
        "COLUMNS": COLUMNS,
        "ROS_DOMAIN_ID": DOMAIN,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    # A child sets up the libraries of the ROS wheels itself.
    kept = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    return kept | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"} | mine


def photograph(page: Path, picture: Path) -> None:
    """Take a picture of the first screen of a page, if there is a browser."""
    browser = shutil.which("chromium")
    if browser is None:
        print(f"{picture.name} stays as it is: chromium is not installed")
        return
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-sync")
    quiet = ("--disable-background-networking", "--virtual-time-budget=5000")
    with tempfile.TemporaryDirectory() as profile:
        target = (f"--user-data-dir={profile}", f"--window-size={PAGE}", f"--screenshot={picture}")
        subprocess.run(
            [browser, *flags, *quiet, *target, page.as_uri()], check=True, capture_output=True
        )


def processor() -> str:
    """Return the processor and the number of cores."""
    with contextlib.suppress(OSError):
        match = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
        if match:
            return f"{match[1]}, {os.cpu_count()} cores"
    return f"{os.cpu_count()} cores"


if __name__ == "__main__":
    main()
