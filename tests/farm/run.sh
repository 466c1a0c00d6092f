#!/usr/bin/env bash
# Runs the job that `lvox farm` prints by schedulers as they are: Slurm, Open Job Description, GNU parallel. Workers are killed
# in mid-tile, and the merged image has to have the bytes that one process makes. OpenImageIO reads it, and pastes its tiles.
# Installs what is missing by apt and pip where it may; what cannot be had is SKIPPED. Ends with: N passed, N failed.
# Slurm runs on loopback alone, in a folder that goes away, with its own key and ports.
set -u
cd "$(dirname "$0")/../.." || exit 1

cargo build --release || exit 1
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")
out=$(mktemp -d)
chmod 755 "$out"
. tests/support/checks.sh

skip() { printf 'SKIPPED: tests/farm/run.sh, %s\n' "$1"; }

# installed PROGRAM PACKAGE...: whether there is a program, if need be once the packages are installed.
installed() {
    local program=$1
    shift
    command -v "$program" >/dev/null && return 0
    DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$@" >"$out/apt.log" 2>&1
    command -v "$program" >/dev/null
}
PATH=$PATH:/usr/sbin:/sbin

# ended PIDFILE...: asks daemons to end, and waits until they have.
ended() {
    local file pid
    for file in "$@"; do
        pid=$(cat "$file" 2>/dev/null) || continue
        kill "$pid" 2>/dev/null
        for _ in $(seq 50); do
            kill -0 "$pid" 2>/dev/null || continue 2
            sleep 0.2
        done
        kill -9 "$pid" 2>/dev/null
    done
}
finish() {
    [ -z "${SLURM_CONF:-}" ] || timeout 20 scancel --user "$(id -un)" >/dev/null 2>&1
    ended "$out/slurm/slurmd.pid" "$out/slurm/ctld.pid" "$out/munge/pid"
    rm -rf "$out"
}
trap finish EXIT
trap 'exit 130' INT TERM

# The job as all run it, each in a folder of its own: a cloud in two parts, its tree, light in media, and four tiles of equal
# work that take some seconds each, so that workers can be killed.
job=(--demo --resolution 160x120 -o image.exr --parts 2 --tiles 4 --bounces 1 --task-threads 1
    --bake '--surfels 50000' --shade '--samples 2000 --lattice 2 --edge-samples 64 --aov depth,normal')
PATH=$(dirname "$lvox"):$PATH

# The same by one process after the other, without parts and tiles.
alone() (
    mkdir "$out/alone" && cd "$out/alone" || return 1
    demo=(--demo --resolution 160x120)
    lvox bake "${demo[@]}" -o a.lvc --surfels 50000 && lvox build a.lvc -o a.lvt &&
        lvox scatter "${demo[@]}" -t a.lvt -o a.lvs &&
        lvox pack "${demo[@]}" -t a.lvt --scatter a.lvs -o a.lvp &&
        lvox shade a.lvp -o image.exr --samples 2000 --lattice 2 --edge-samples 64 --aov depth,normal
)
quiet() { "$@" >"$out/log" 2>&1 || { tail -n 20 "$out/log"; return 1; }; }
check 'one process makes the image' quiet alone
whole=$out/alone/image.exr

# slurm_starts: munge, the controller and one node, on loopback.
slurm_starts() {
    local d=$out/slurm m=$out/munge
    mkdir -p "$d/ctld" "$d/slurmd" "$m" && chmod 711 "$m"
    head -c 1024 /dev/urandom >"$m/key" && chmod 400 "$m/key"
    munged --key-file="$m/key" --socket="$m/sock" --pid-file="$m/pid" --log-file="$m/log" --seed-file="$m/seed" --force ||
        return 1
    cat >"$d/slurm.conf" <<CONF
ClusterName=test
SlurmctldHost=localhost
SlurmctldPort=26817
SlurmdPort=26818
AuthType=auth/munge
AuthInfo=cred_expire=5,socket=$m/sock
CredType=cred/munge
SlurmUser=root
SlurmdUser=root
StateSaveLocation=$d/ctld
SlurmdSpoolDir=$d/slurmd
SlurmctldPidFile=$d/ctld.pid
SlurmdPidFile=$d/slurmd.pid
SlurmctldLogFile=$d/ctld.log
SlurmdLogFile=$d/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
AccountingStorageType=accounting_storage/none
SchedulerParameters=sched_interval=2,sched_min_interval=0
MpiDefault=none
ReturnToService=2
NodeName=localhost CPUs=$(nproc) RealMemory=1000
PartitionName=main Nodes=ALL Default=YES State=UP
CONF
    export SLURM_CONF=$d/slurm.conf
    slurmctld && slurmd -N localhost || return 1
    for _ in $(seq 60); do
        sinfo -h -o %t 2>/dev/null | grep -q idle && return 0
        sleep 0.5
    done
    tail -n 20 "$d"/*.log
    return 1
}

# waits SECONDS COMMAND...: until the command succeeds.
waits() {
    local end=$((SECONDS + $1))
    shift
    until "$@"; do
        [ "$SECONDS" -lt "$end" ] || return 1
        sleep 0.2
    done
}

# worker TILE: the process that shades a tile.
worker() { pgrep -f "^lvox shade .*--tile $1/4 " | head -n 1; }
works() { [ -n "$(worker "$1")" ]; }
# killed TILE: kills the process that shades a tile, in the midst of it.
killed() {
    local pid
    waits 60 works "$1" || return 1
    sleep 0.3
    pid=$(worker "$1")
    kill -9 "$pid" && printf 'killed %s, which shaded tile %s\n' "$pid" "$1"
}
no_jobs() { [ -z "$(squeue -h -o %i)" ]; }

slurm() (
    mkdir "$out/by-slurm" && cd "$out/by-slurm" || return 1
    slurm_starts || return 1
    lvox farm slurm "${job[@]}" >job.sh && bash job.sh || return 1
    # One worker dies as if memory ran out, another task is taken back by the scheduler.
    killed 1 || { squeue; return 1; }
    waits 60 works 2 || { squeue; return 1; }
    scontrol requeue "$(squeue -h -r -n lvox-tile -t RUNNING -o '%i %K' | awk '$2 == 2 { print $1 }')" || return 1
    waits 150 no_jobs || { squeue; return 1; }
    [ -s image.exr ]
)
if installed sbatch slurm-wlm munge && installed slurmctld slurm-wlm && installed munged munge; then
    if [ "$(id -u)" -eq 0 ]; then
        check 'Slurm runs the job, though a worker is killed and a task is taken back' quiet slurm
        check 'the image of Slurm has the bytes of one process' cmp "$out/by-slurm/image.exr" "$whole"
        export SLURM_CONF=$out/slurm/slurm.conf
    else
        skip 'Slurm: needs root'
    fi
else
    skip 'Slurm: needs slurm-wlm and munge'
fi

openjd_found() {
    command -v openjd >/dev/null && return 0
    python3 -m venv "$out/venv" >"$out/pip.log" 2>&1 && "$out/venv/bin/pip" install --quiet openjd-cli >>"$out/pip.log" 2>&1 &&
        PATH=$PATH:$out/venv/bin && command -v openjd >/dev/null
}
by_openjd() (
    mkdir "$out/by-openjd" && cd "$out/by-openjd" || return 1
    lvox farm openjd "${job[@]}" >job.template.json && openjd check job.template.json || return 1
    openjd run job.template.json -p Folder="$PWD" && [ -s image.exr ]
)
if openjd_found; then
    check 'openjd runs the job' quiet by_openjd
    check 'the image of openjd has the bytes of one process' cmp "$out/by-openjd/image.exr" "$whole"
else
    skip 'Open Job Description: needs openjd-cli, from Python'"'"'s packages'
fi

by_parallel() (
    mkdir "$out/by-parallel" && cd "$out/by-parallel" || return 1
    for step in bake tree cut tile merge; do
        lvox farm commands "${job[@]}" --step $step >$step.sh || return 1
        # Of a step that fails, as its worker is killed, all is given again: what is made stays.
        parallel --will-cite -j2 --halt soon,fail=1 <$step.sh &
        if [ $step = tile ]; then
            killed 0
            wait $! && { echo 'the killed worker was not missed'; return 1; }
            [ ! -e image.exr ] || return 1
            parallel --will-cite -j2 <$step.sh || return 1
        else
            wait $! || return 1
        fi
    done
)
if installed parallel parallel; then
    check 'GNU parallel runs the job, and goes on where a worker was killed' quiet by_parallel
    check 'the image of GNU parallel has the bytes of one process' cmp "$out/by-parallel/image.exr" "$whole"
else
    skip 'GNU parallel: needs parallel'
fi

# Others read the layers, and pasted together the tiles are the frame.
by_oiiotool() (
    cd "$out/by-parallel" || return 1
    oiiotool --info -v image.exr | grep 'channel list: R .*, G .*, B .*, depth.Z .*, normal.X .*' || return 1
    pasted=(--create 160x120 7)
    for i in 0 1 2 3; do pasted+=("farm/demo/tile.$i.exr" --swap --paste +0+0); done
    oiiotool "${pasted[@]}" "$whole" --fail 0 --warn 0 --diff
)
if ! installed oiiotool openimageio-tools; then
    skip 'pictures: needs openimageio-tools'
elif [ -d "$out/by-parallel" ]; then
    check 'oiiotool reads the layers, and pastes the tiles to the same pixels' quiet by_oiiotool
fi

told
