"""The workflow of examples/workflow by Snakemake: its tables are those of `rig batch`.

snakemake_batch.py RIG_BINARY SNAKEMAKE
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from small_sessions import FIT, ROOT, capture

RIG, SNAKEMAKE = [str(Path(path).absolute()) for path in sys.argv[1:3]]


def main():
    with tempfile.TemporaryDirectory(prefix="rig-snakemake-") as work:
        work = Path(work)
        sessions = []
        for path in capture(RIG, work, 3):
            moved = work / "my sessions" / path.name
            moved.parent.mkdir(exist_ok=True)
            path.rename(moved)
            sessions.append(str(moved.relative_to(work)))
        # What a queue leaves among them is passed over.
        (work / "my sessions/samples.queue.jsonl").write_text("")
        # One of them cannot be fitted.
        (work / sessions[1] / "derived/radiance_L000.exr").write_text("no image")
        command = [SNAKEMAKE, "--snakefile", str(ROOT / "examples/workflow/Snakefile"), "--cores", "2"]
        command += ["--quiet", "all", "--config", f"sessions={' '.join(sessions)} my sessions/*.jsonl", f"fit={FIT}", f"rig={RIG}"]
        done = subprocess.run(command, cwd=work, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"FAILED the workflow: {done.stdout}{done.stderr}")
        # The fits are there, and the same process joins the same rows.
        alone = [RIG, "--quiet", "batch", *sessions, "--out", "alone", "--fit", FIT]
        subprocess.run(alone, cwd=work, capture_output=True)
        for name in ["table.csv", "table.json"]:
            if (work / "batch" / name).read_bytes() != (work / "alone" / name).read_bytes():
                sys.exit(f"FAILED {name} differs")
        rows = (work / "batch/table.csv").read_text().splitlines()
        assert len(rows) == 4 and ",failed," in rows[2], rows
        print("ok the workflow's tables are those of one process, a failure among them")


main()
