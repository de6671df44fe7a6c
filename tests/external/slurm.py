"""A batch and an experiment on a Slurm of one node: submitted as `rig` prints them, with tasks
that are killed at random, and compared byte for byte with one process.

slurm.py RIG_BINARY [SEED]

Slurm's daemons run here, without accounting, control groups or systemd.
"""

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from small_sessions import FIT, capture

RIG = str(Path(sys.argv[1]).resolve())
SEED = int(sys.argv[2]) if len(sys.argv) > 2 else 1
SESSIONS = 8
EXPERIMENT = ["evaluate", "shapes", "--quick", "--resolution", "16", "--spp", "64", "--portable"]
EXPERIMENT += ["--materials", "synthetic:cream-satin", "nbrdf:pvc"]

CONFIGURATION = """
ClusterName=rig
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmctldPort={port}
SlurmdPort={slurmd_port}
AuthType=auth/munge
AuthInfo=socket={base}/munge.socket
StateSaveLocation={base}/state
SlurmdSpoolDir={base}/spool
SlurmctldPidFile={base}/slurmctld.pid
SlurmdPidFile={base}/slurmd.pid
SlurmctldLogFile={base}/slurmctld.log
SlurmdLogFile={base}/slurmd.log
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
KillWait=5
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=2000 State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""

checks = 0


def check(name, is_so, shown=""):
    global checks
    if not is_so:
        sys.exit(f"FAILED {name}: {shown}")
    checks += 1
    print(f"ok {name}", flush=True)


def run(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    if done.returncode != 0:
        sys.exit(f"FAILED {' '.join(command)}: {done.stderr}")
    return done.stdout


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


class Cluster:
    """Slurm's daemons, in the foreground as children of this process."""

    def __init__(self, base):
        self.base = base
        self.daemons = []
        for folder in ["state", "spool"]:
            (base / folder).mkdir()
        host = socket.gethostname().split(".")[0]
        fields = dict(host=host, base=base, port=free_port(), slurmd_port=free_port())
        (base / "slurm.conf").write_text(CONFIGURATION.format(**fields))
        os.environ["SLURM_CONF"] = str(base / "slurm.conf")
        (base / "munge.key").write_bytes(os.urandom(128))
        (base / "munge.key").chmod(0o400)
        files = [f"--{what}-file={base}/munge.{what}" for what in ["key", "pid", "log", "seed"]]
        self.start("munged", "--foreground", "--force", f"--socket={base}/munge.socket", *files)
        self.until("munge answers", lambda: (base / "munge.socket").exists())
        self.start("slurmctld", "-D", "-i")
        self.start("slurmd", "-D", "-N", host)
        self.until("the node is idle", lambda: "idle" in self.ask("sinfo", "-h", "-o", "%T"))

    def start(self, *command):
        log = open(self.base / f"{command[0]}.out", "w")
        path = shutil.which(command[0], path=f"{os.environ['PATH']}:/usr/sbin")
        daemon = subprocess.Popen([path, *command[1:]], stdout=log, stderr=log)
        self.daemons.append(daemon)

    def ask(self, *command):
        return subprocess.run(command, capture_output=True, text=True).stdout.strip()

    def until(self, what, is_so, patience_s=60):
        began = time.monotonic()
        while not is_so():
            if time.monotonic() - began > patience_s:
                logs = "".join(path.read_text() for path in self.base.glob("*.out"))
                sys.exit(f"FAILED {what}: {logs[-3000:]}")
            time.sleep(0.1)

    def stop(self):
        for daemon in reversed(self.daemons):
            daemon.send_signal(signal.SIGTERM)
        for daemon in self.daemons:
            try:
                daemon.wait(10)
            except subprocess.TimeoutExpired:
                daemon.kill()

    def queue(self):
        """Tasks and jobs in the queue, running ones first: (name, state)."""
        lines = self.ask("squeue", "-h", "-r", "-o", "%i %T").splitlines()
        return sorted((line.split() for line in lines), key=lambda job: job[1] != "RUNNING")


def rig_processes(folder):
    """Processes of the program at work in this folder."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and os.readlink(entry / "exe") == RIG:
                if Path(os.readlink(entry / "cwd")).is_relative_to(folder):
                    found.append(int(entry.name))
        except OSError:
            pass
    return found


def submit_and_kill(cluster, script, folder, chance, kills, left):
    """Submits once, kills `left` times at random moments in three ways, and waits for the end."""
    subprocess.run(["sh"], input=script, text=True, check=True, stdout=subprocess.DEVNULL)
    while queue := cluster.queue():
        running = [job for job, state in queue if state == "RUNNING"]
        if running and left > 0 and chance.random() < 0.2:
            way = chance.choice(["scancel", "requeue", "kill -9"])
            if way == "scancel":
                cluster.ask("scancel", chance.choice(running))
            elif way == "requeue":
                cluster.ask("scontrol", "requeue", chance.choice(running))
            elif processes := rig_processes(folder):
                os.kill(chance.choice(processes), signal.SIGKILL)
            kills[way] = kills.get(way, 0) + 1
            left -= 1
        # A requeued task would wait for minutes: Slurm holds it back by its begin time.
        for job, state in queue:
            if state == "PENDING":
                cluster.ask("scontrol", "update", f"JobId={job}", "StartTime=now")
        time.sleep(0.15)


def files(folder, names):
    return {name: (folder / name).read_bytes() for name in names}


def batch(cluster, work, chance):
    """The batch with kills, and by one process."""
    tables = ["table.csv", "table.json"]
    sessions = capture(RIG, work, SESSIONS)
    other = work / "alone"
    shutil.copytree(work / "sessions", other / "sessions")
    shutil.copy(work / "few.toml", other)
    names = [str(path.relative_to(work)) for path in sessions]
    began = time.monotonic()
    run(RIG, "--quiet", "batch", *names, "--out", "batch", "--fit", FIT, cwd=other)
    alone_s = time.monotonic() - began

    run(RIG, "--quiet", "batch", "new", *names, "--out", "batch", "--fit", FIT, cwd=work)
    script = run(RIG, "batch", "slurm", "batch", "--tasks", "4", "--task-memory", "700", cwd=work)
    check("nothing is submitted by printing", cluster.queue() == [])
    kills, submissions = {}, 0
    while not (work / "batch/table.json").exists() or '"open": 0' not in (work / "batch/table.json").read_text():
        submissions += 1
        submit_and_kill(cluster, script, work, chance, kills, 8 - 2 * submissions)
        if submissions > 8:
            sys.exit("FAILED the batch does not end")
    check(f"a batch survives kills ({kills}, {submissions} submissions)", sum(kills.values()) > 3)
    check(
        "its tables are those of one process",
        files(work / "batch", tables) == files(other / "batch", tables),
    )
    fits = [len(list((path / "fits").glob("*/fit.toml"))) for path in sessions]
    check("no session was fitted twice", fits == [1] * SESSIONS, fits)

    # Without kills and with everything done: what the submission itself costs.
    began = time.monotonic()
    subprocess.run(["sh"], input=script, text=True, check=True, stdout=subprocess.DEVNULL)
    cluster.until("the queue is empty", lambda: cluster.queue() == [], 120)
    idle_s = time.monotonic() - began
    print(f"   {SESSIONS} jobs by one process: {alone_s:.1f} s; 4 tasks with nothing to do: {idle_s:.1f} s")


def experiment(cluster, work, chance):
    """An experiment in shards with kills, and by one process."""
    work.mkdir()
    run(RIG, "--quiet", *EXPERIMENT, "--out", "alone", cwd=work)
    script = run(RIG, *EXPERIMENT, "--out", "shards", "--slurm", "3", "--task-memory", "700", cwd=work)
    check("nothing is submitted by printing an experiment", cluster.queue() == [])
    kills, submissions = {}, 0
    while not (work / "shards/shapes.svg").exists():
        submissions += 1
        submit_and_kill(cluster, script, work, chance, kills, 8 - 2 * submissions)
        if submissions > 8:
            sys.exit("FAILED the experiment does not end")
    results = ["table.csv", "table.json", "shapes.svg"]
    check(
        f"an experiment in shards, killed ({kills}, {submissions} submissions), has the tables of one process",
        files(work / "shards", results) == files(work / "alone", results),
    )


def main():
    # Ended from outside, it takes the daemons with it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("FAILED it was ended"))
    chance = random.Random(SEED)
    with tempfile.TemporaryDirectory(prefix="rig-slurm-") as base:
        base = Path(base)
        cluster = Cluster(base)
        try:
            work = base / "work"
            work.mkdir()
            batch(cluster, work, chance)
            experiment(cluster, base / "experiment", chance)
        finally:
            cluster.stop()
    print(f"{checks} checks pass")


main()
