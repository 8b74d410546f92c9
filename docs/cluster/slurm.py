"""A Dask cluster of Slurm jobs for slamcmp; copy it, adapt what is in capitals, and leave it running.

pip install 'slamcmp[dask]' dask-jobqueue
python slurm.py                                     # on the login node: it prints the address
slamcmp run my.yaml --executor dask --scheduler ADDRESS
"""

from dask_jobqueue import SLURMCluster

QUEUE = "normal"
ACCOUNT = None
WORKERS_PER_JOB, MEMORY_PER_JOB, HOURS = 8, "16GB", 4
JOBS_AT_LEAST, JOBS_AT_MOST = 1, 20
INTERFACE = None  # The network that nodes reach the login node by, such as "ib0".
ENVIRONMENT = ["source $HOME/slamcmp/.venv/bin/activate"]  # Where slamcmp is installed on the nodes.

cluster = SLURMCluster(
    queue=QUEUE,
    account=ACCOUNT,
    # A thread of a worker does one job at a time, in a process of its own below it.
    cores=WORKERS_PER_JOB,
    processes=WORKERS_PER_JOB,
    memory=MEMORY_PER_JOB,
    walltime=f"{HOURS:02d}:00:00",
    interface=INTERFACE,
    job_script_prologue=ENVIRONMENT,
    # Workers end themselves, and hand their jobs on, before Slurm ends them.
    worker_extra_args=["--lifetime", f"{60 * HOURS - 5}m", "--lifetime-stagger", "4m"],
)
cluster.adapt(minimum_jobs=JOBS_AT_LEAST, maximum_jobs=JOBS_AT_MOST)
print(cluster.scheduler_address, flush=True)
input("Enter ends the cluster.\n")
