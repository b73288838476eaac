#!/bin/bash
# A run on a cluster, in as many jobs as it takes: each stops with a checkpoint before its time is over and puts itself
# back into the queue; the next one goes on, on the same or on other nodes.
#
#   sbatch jobs/slurm/plate.sh [DECK [RUNDIR [options of pdfem run]]]        e.g. with sbatch -N 1 -n 16 -t 30
#   scancel --signal=USR1 --batch JOB                                        stops it now; it is queued again
#
# Slurm's own signals do not reach ranks reliably through mpirun, so the batch shell takes them and passes them on. With
# an MPI that Slurm starts, put LAUNCH="srun --mpi=pmi2" (or pmix) before sbatch: see docs/slurm.md.
#SBATCH --job-name=plate --nodes=2 --ntasks-per-node=64 --time=04:00:00
#SBATCH --signal=B:USR1@300 --requeue --open-mode=append
set -u
deck=${1:-jobs/plate_cutout.toml}
run=${2:-runs/plate_cutout}
shift $(($# < 2 ? $# : 2))
export OMP_NUM_THREADS=1

newest() { ls "$run/checkpoints" 2>/dev/null | grep -E '^ckpt-[0-9]+\.h5$' | tail -1; }

before=$(newest)
${LAUNCH:-mpirun -n $SLURM_NTASKS} pdfem run "$deck" --out "$run" --max-hours 3.8 "$@" &
pid=$!
trap 'kill -USR1 $pid 2>/dev/null' USR1 TERM
wait $pid
code=$?
while kill -0 $pid 2>/dev/null; do # a trap ends `wait` before the run does
    wait $pid
    code=$?
done

# 0 finished, 75 stopped with a checkpoint; a lost node ends in other codes, and the run goes on as well.
# What the deck, the folder or the physics will not let go on (64, 65, 73, 74) does not, nor do three jobs without progress.
case $code in 0 | 64 | 65 | 73 | 74) exit $code ;; esac
idle=$run/jobs_without_progress
if [ "$(newest)" = "$before" ]; then echo x >>"$idle"; else rm -f "$idle"; fi
if [ -f "$idle" ] && [ "$(wc -l <"$idle")" -ge 3 ]; then
    echo "three jobs without a new checkpoint: not put back into the queue" >&2
    exit $code
fi
scontrol requeue "$SLURM_JOB_ID"
exit $code
