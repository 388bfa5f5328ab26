#!/usr/bin/env bash
# Sets particles_mpi up in .venv (only what is not done yet) and runs it under MPI. ./run.sh help lists the commands.
set -euo pipefail
HERE=$PWD
cd "$(dirname "${BASH_SOURCE[0]}")"

help() {
  cat <<'TEXT'
./run.sh                 set up, then the main job: particles_mpi/scenes/marbles.toml on 2 ranks, into out/marbles
./run.sh test [...]      set up, then test every feature, three tests at once (arguments go to pytest: tests/unit, -k WORD)
./run.sh test --all      the same and all longer tests: more ranks, long physics, killed runs
./run.sh test --search   the same and many more random scenes, some of them new each time, in search of faults
./run.sh lint            ruff (rules and format) and mypy
./run.sh setup           only set up
./run.sh view DIR        write DIR/view.html, a page that shows the run in that folder, and open it
./run.sh doctor          show what is installed, and whether it works together
./run.sh COMMAND [...]   anything else goes to particles-mpi under mpirun, or srun in a job of Slurm: run, check, study, --help;
                         file names are relative to the folder that you are in

RANKS=4 ./run.sh ...              number of MPI ranks (default: 2; in a job of Slurm: its tasks)
PYTHON=python3.12 ./run.sh ...    the Python >= 3.11 that makes .venv (only the first time)
PARTICLES_MPI_SETUP=apt|system|pip ./run.sh setup     where MPI comes from; by default:
   apt      for root with apt: installs Open MPI and parallel HDF5, and builds h5py on them
   system   if mpicc and mpirun are there already; uses a parallel HDF5 if there is one for this MPI
   pip      otherwise: MPICH from PyPI, into .venv

Set-up starts over after `rm -rf .venv`; its output is in .venv/setup.log.
After `source .venv/bin/activate` your shell finds the right mpirun and particles-mpi.
TEXT
}

VENV=$PWD/.venv DONE=.venv/done LOG=.venv/setup.log PY=.venv/bin/python
APT_PACKAGES=(openmpi-bin libopenmpi-dev libhdf5-openmpi-dev)

# --- telling what happens ---------------------------------------------------------------------------------------------

fail() { printf 'run.sh: %s\n' "$*" >&2; exit 1; }
note() { printf '  note: %s\n' "$*"; }
digest() { sha256sum | cut -c1-16; }
was_done() { [[ -f $DONE/$1 && $(<"$DONE/$1") == "$2" ]]; }

timed() {  # timed TEXT COMMAND...: one line with the seconds, the noise into the log
  local text=$1 start=$SECONDS from status=0; shift
  printf '  %-68s' "$text"
  from=$(wc -l 2>/dev/null <"$LOG" || echo 0)
  "$@" >>"$LOG" 2>&1 || status=$?
  if ((status)); then
    printf 'failed after %d s\n' $((SECONDS - start))
    LOG_TAIL=$(tail -n +$((from + 1)) "$LOG" | tail -n 20)
  else
    printf '%4d s\n' $((SECONDS - start))
  fi
  return "$status"
}

step() {  # step NAME KEY TEXT COMMAND...: unless it was done before with the same key
  local name=$1 key=$2; shift 2
  was_done "$name" "$key" && return
  timed "$@" || { printf '%s\n' "$LOG_TAIL" >&2; fail "set-up stopped here; the whole log: $LOG"; }
  printf '%s' "$key" >"$DONE/$name"
}

# --- where MPI comes from ---------------------------------------------------------------------------------------------

as_root_with_apt() { [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; }
apt_install() {
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@"
}

choose_case() {
  if [[ -n ${PARTICLES_MPI_SETUP:-} ]]; then echo "$PARTICLES_MPI_SETUP"  # choose_mpi knows which exist
  elif [[ -f $DONE/case ]]; then cat "$DONE/case"
  elif as_root_with_apt; then echo apt
  elif system_mpicc >/dev/null; then echo system
  else echo pip; fi
}

outside_venv() { PATH=${PATH//"$VENV/bin:"/} command -v "$@"; }
system_mpicc() {  # an mpicc with its own mpirun beside it: taking both from one folder keeps them one MPI
  local cc; cc=$(outside_venv mpicc) && [[ -x ${cc%/*}/mpirun || -x ${cc%/*}/mpiexec ]] && echo "$cc"
}

choose_mpi() {  # sets MPICC and LAUNCHER from CASE
  case $CASE in
    apt) MPICC=/usr/bin/mpicc.openmpi LAUNCHER=/usr/bin/mpirun.openmpi ;;
    system)
      MPICC=$(system_mpicc) || fail "PARTICLES_MPI_SETUP=system, but no mpicc with an mpirun beside it is on the PATH"
      LAUNCHER=${MPICC%/*}/mpirun; [[ -x $LAUNCHER ]] || LAUNCHER=${MPICC%/*}/mpiexec ;;
    pip) MPICC='' LAUNCHER='' ;;  # the mpich wheel puts its own mpirun into .venv/bin
    *) fail "PARTICLES_MPI_SETUP is '$CASE'; it can be apt, system or pip" ;;
  esac
}

parallel_hdf5() {  # the folder of a parallel HDF5 made for this MPI, if there is one
  local family=openmpi folder pkg
  [[ -n $MPICC ]] || return 1
  "$MPICC" -show 2>/dev/null | grep -qi 'mpich' && family=mpich
  for folder in "${HDF5_DIR:-}" /usr/lib/*/hdf5/$family \
    "$(dirname "$(dirname "$(outside_venv h5pcc || echo /none/none/none)")")" \
    "$(for pkg in hdf5-$family hdf5-mpi hdf5; do pkg-config --variable=prefix $pkg 2>/dev/null && break; done)"; do
    if [[ -n $folder ]] && cat "$folder"/include/H5pubconf*.h 2>/dev/null | grep -q 'define H5_HAVE_PARALLEL 1'; then
      echo "$folder"; return
    fi
  done
  return 1
}

# --- the steps --------------------------------------------------------------------------------------------------------

good_python() { "$1" -c 'import sys; raise SystemExit(sys.version_info < (3, 11))' 2>/dev/null; }
find_python() {
  local name
  for name in ${PYTHON:-python3 python3.13 python3.12 python3.11}; do
    if good_python "$name"; then echo "$name"; return; fi
  done
  return 1
}

make_venv() {
  local python again=() start=$SECONDS
  if [[ -f $DONE/folder && $(<"$DONE/folder") != "$VENV" ]]; then
    note ".venv was made for $(<"$DONE/folder"): it is made again"; again=(--clear)
  elif [[ -f $DONE/case && $(<"$DONE/case") != "$CASE" ]]; then
    note ".venv was made for '$(<"$DONE/case")': it is made again for '$CASE'"; again=(--clear)
  elif [[ -x $PY ]]; then
    good_python "$PY" || fail ".venv has $($PY --version 2>&1), but Python >= 3.11 is needed: rm -rf .venv, then ./run.sh again"
    mkdir -p "$DONE" && printf '%s' "$VENV" >"$DONE/folder"; return
  fi
  python=$(find_python || install_python) || fail "Python >= 3.11 is needed; name one: PYTHON=/path/to/python3 ./run.sh"
  if ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
    as_root_with_apt || fail "$python has no venv module: install python3-venv, or name another: PYTHON=... ./run.sh"
    apt_install "$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')" >/dev/null 2>&1 \
      || fail "$python has no venv module and apt could not install it"
  fi
  "$python" -m venv "${again[@]}" .venv || fail "$python could not make .venv"
  mkdir -p "$DONE"
  printf '%s' "$VENV" >"$DONE/folder"
  printf '  %-68s%4d s\n' "$($PY --version) in .venv" $((SECONDS - start))
}

install_python() {  # Debian calls it python3; Ubuntu 22.04 has 3.11 beside its 3.10
  as_root_with_apt && [[ -z ${PYTHON:-} ]] || return 1
  { apt_install python3 python3-venv >&2 && find_python; } 2>/dev/null \
    || { apt_install python3.11 python3.11-venv >&2 && find_python; } 2>/dev/null
}

install_apt() {
  local wanted=("${APT_PACKAGES[@]}") header
  header=$($PY -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
  command -v gcc >/dev/null || wanted+=(gcc libc6-dev)
  [[ -f $header ]] || wanted+=("$($PY -c 'import sys; print("python%d.%d-dev" % sys.version_info[:2])')")
  if dpkg -s "${wanted[@]}" >/dev/null 2>&1; then echo 'all there already'; else apt_install "${wanted[@]}"; fi
}

apt_or_another() {
  if timed 'apt: Open MPI, parallel HDF5' install_apt; then printf '%s' "${APT_PACKAGES[*]}" >"$DONE/apt"; return; fi
  printf '%s\n' "$LOG_TAIL" >&2
  [[ -z ${PARTICLES_MPI_SETUP:-} ]] || fail "apt could not install: ${APT_PACKAGES[*]}; the whole log: $LOG"
  if system_mpicc >/dev/null; then CASE=system; else CASE=pip; fi
  note "apt could not install Open MPI; continuing with '$CASE'"
  choose_mpi
}

pip() { "$VENV/bin/python" -m pip install --disable-pip-version-check "$@"; }
install_base() {  # all that a build of h5py needs; numba is here because it decides the version of numpy
  local more=()
  [[ $CASE == pip ]] && more=(mpich)
  pip mpi4py numpy numba 'cython<4' pkgconfig packaging 'setuptools>=77' wheel "${more[@]}"
}

# The MPI environment, in one file: read by this script, and by the mpirun of .venv/bin whoever starts it.
write_mpi_settings() {
  cat >.venv/mpi.env <<'TEXT'  # what the user has set already, stays
export OMPI_ALLOW_RUN_AS_ROOT="${OMPI_ALLOW_RUN_AS_ROOT:-1}"  # containers; v4 and v5 both ask
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="${OMPI_ALLOW_RUN_AS_ROOT_CONFIRM:-1}"
export OMPI_MCA_rmaps_base_oversubscribe="${OMPI_MCA_rmaps_base_oversubscribe:-1}"  # more ranks than cores: v4
export PRTE_MCA_rmaps_default_mapping_policy="${PRTE_MCA_rmaps_default_mapping_policy:-:oversubscribe}"  # v5
export OMPI_MCA_hwloc_base_binding_policy="${OMPI_MCA_hwloc_base_binding_policy:-none}"  # bound, two runs on one machine would sit on the same core: v4
export PRTE_MCA_hwloc_default_binding_policy="${PRTE_MCA_hwloc_default_binding_policy:-none}"  # v5
export OMPI_MCA_odls_base_sigkill_timeout="${OMPI_MCA_odls_base_sigkill_timeout:-0}"  # seconds from a rank that failed to the end of all: it waits until its message is read
export GLIBC_TUNABLES="${GLIBC_TUNABLES:-glibc.malloc.hugetlb=1}"  # large pages for large arrays: a tenth faster at a million particles
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"  # one rank, one core
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
export MKL_NUM_THREADS="${MKL_NUM_THREADS:-1}"
export NUMBA_NUM_THREADS="${NUMBA_NUM_THREADS:-1}"
TEXT
  [[ -n $LAUNCHER ]] || return 0
  # the launcher, without its paragraphs about ranks that have said themselves why they end
  printf '#!/bin/sh\n. "%s/mpi.env"\nexec "%s/bin/python" -IS "%s/particles_mpi/parallel/launcher.py" "%s" "$@"\n' \
    "$VENV" "$VENV" "$PWD" "$LAUNCHER" >.venv/bin/mpirun
  chmod +x .venv/bin/mpirun
  ln -sf mpirun .venv/bin/mpiexec
}

two_ranks() {  # do two ranks see each other? ANSWER is all they say
  ANSWER=$($PY -P particles_mpi/run/doctor.py)
  printf 'two ranks: %s\n' "$ANSWER"
  if [[ $ANSWER == *'errno = 1'* ]] && ! grep -q single_copy .venv/mpi.env; then  # a container without ptrace
    echo 'export OMPI_MCA_btl_vader_single_copy_mechanism="${OMPI_MCA_btl_vader_single_copy_mechanism:-none}"' >>.venv/mpi.env
  fi
  [[ $ANSWER == *'"size": 2'* && $ANSWER == *'"sum_right": true'* ]]
}
install_mpi4py() {  # the wheel finds most MPIs by itself; where it does not, it is built against this one
  write_mpi_settings
  two_ranks && return
  [[ -n $MPICC ]] && MPICC=$MPICC pip --force-reinstall --no-deps --no-cache-dir --no-binary=mpi4py mpi4py && two_ranks
}

install_browser() {  # for the tests of the page that shows a run; without one they are skipped
  command -v chromium chromium-browser google-chrome >/dev/null && return
  as_root_with_apt && timed 'apt: chromium, which shows pages to the tests' apt_install chromium && return
  note 'no browser (chromium): the tests of the page that shows a run are skipped'
}

build_parallel_h5py() {  # into a wheel, kept so that the next clone need not build it
  printf '[build_ext]\nparallel = %d\n' "$(nproc)" >.venv/build.cfg
  DIST_EXTRA_CONFIG=$VENV/build.cfg H5PY_SETUP_REQUIRES=0 HDF5_MPI=ON CC=$MPICC CFLAGS='-O1 -g0' HDF5_DIR=$HDF5 \
    "$VENV/bin/python" -m pip wheel --no-deps --no-cache-dir --no-build-isolation --no-binary=h5py -w .venv/wheel h5py \
    && mkdir -p "$WHEELS" && cp .venv/wheel/h5py-*.whl "$WHEELS/"
}

use_parallel_h5py() {
  wait "$1" || return
  pip --force-reinstall --no-deps "$WHEELS"/h5py-*.whl && two_ranks && [[ $ANSWER == *'"written": true'* ]] && return
  rm -rf "$WHEELS"
  return 1
}

parallel_h5py_failed() {
  note "parallel h5py could not be built (see .venv/h5py.log): the serial one is used, one rank gathers and writes"
  pip --force-reinstall --no-deps --only-binary=h5py h5py >>"$LOG" 2>&1 || fail "h5py cannot be installed: see $LOG"
}

warm_up() {  # compile the kernels now, so that the first run, or four test ranks at once, need not
  local key
  [[ -f particles_mpi/setup/warmup.py ]] || return 0
  key=$(find particles_mpi -name '*.py' -print0 | sort -z | xargs -0 cat | digest)
  was_done kernels "$key" && return
  lock
  compile_kernels "$key"
  exec 9<&-
}

compile_kernels() {
  local key=$1
  was_done kernels "$key" && return  # by the one that this one has waited for
  [[ -f $DONE/kernels ]] || note 'compiling kernels now, once, for one to five minutes'
  $PY -m compileall -q particles_mpi || true  # also where Python is told to write no bytecode: 0.1 s less for each start
  if $PY -P particles_mpi/setup/kernel_sources.py || mpirun -n 2 $PY -m particles_mpi.setup.warmup; then printf '%s' "$key" >"$DONE/kernels"
  else note 'kernels could not be compiled in advance: the first run compiles them'; fi
}

lock() {  # two run.sh at once: the second waits
  local status=0
  exec 9<.
  flock -n 9 2>/dev/null || status=$?
  ((status == 1)) || return 0  # not 1 where there are no locks
  note 'another run.sh is working here: this one waits for it'
  flock 9 || true
}

BUILD=''  # the process that builds h5py beside the other steps
stop_building() { [[ -z $BUILD ]] || kill -- -"$BUILD" 2>/dev/null || true; }

setup() {  # setup [test]: with what the tests need
  local start=$SECONDS extras=${1:-} CASE MPICC LAUNCHER HDF5='' WHEELS='' ANSWER='' LOG_TAIL='' project mark
  lock
  CASE=$(choose_case)
  project=$(cat pyproject.toml | digest)
  mark="$VENV $CASE $project $(digest <run.sh)"
  if ! was_done all "$mark $extras" && ! was_done all "$mark test"; then
    choose_mpi
    echo "setting up in .venv (MPI: $CASE)"
    make_venv
    [[ $CASE != apt ]] || was_done apt "${APT_PACKAGES[*]}" || apt_or_another
    printf '%s' "$CASE" >"$DONE/case"
    step base "$(declare -f install_base | digest)" 'pip: mpi4py, numpy, numba, build tools' install_base
    step mpi "$LAUNCHER $(declare -f write_mpi_settings | digest)" 'mpirun: two ranks see each other' install_mpi4py

    if HDF5=$(parallel_hdf5) && ! was_done h5py "$MPICC $HDF5"; then
      WHEELS=${XDG_CACHE_HOME:-$HOME/.cache}/particles_mpi/h5py-$( { $PY --version; "$LAUNCHER" --version | tr -cd '0-9.\n'; "$MPICC" -show
        cat "$HDF5"/include/H5pubconf*.h; echo "$HDF5"; } 2>&1 | digest)
      # goes on beside the next steps: it keeps one core busy for a minute. With all that it starts it is a group of its own
      trap stop_building EXIT
      set -m
      if compgen -G "$WHEELS/h5py-*.whl" >/dev/null; then true & else build_parallel_h5py >.venv/h5py.log 2>&1 </dev/null 9<&- & fi
      BUILD=$!
      set +m
    fi
    step package "$project" 'pip: particles-mpi and what it needs' pip -e .
    [[ $extras != test ]] || { step tests "$project" 'pip: what the tests need' pip -e '.[test]'; install_browser; }
    if [[ -n $BUILD ]]; then
      if timed 'h5py on parallel HDF5 (a build of about a minute, once)' use_parallel_h5py "$BUILD"; then :; else
        parallel_h5py_failed
      fi
      BUILD=''
      printf '%s' "$MPICC $HDF5" >"$DONE/h5py"
    elif [[ -z $HDF5 ]]; then
      note 'no parallel HDF5 for this MPI: one rank gathers and writes, the files are the same'
    fi
    printf '%s' "$mark $extras" >"$DONE/all"
    echo "set up in $((SECONDS - start)) s"
  fi
  export PATH=$VENV/bin:${PATH//"$VENV/bin:"/}
  . .venv/mpi.env
  exec 9<&-
}

launch() {  # launch COMMAND...: on ranks; in a job of Slurm its srun starts them, if it speaks the language of this MPI
  local ranks=${RANKS:-${SLURM_NTASKS:-}} pmi=pmi2
  [[ ! ${RANKS:-1} =~ ^[1-9][0-9]*$ ]] && fail "RANKS: ${RANKS@Q} is not a number of ranks"
  if [[ -n ${SLURM_JOB_ID:-} ]] && command -v srun >/dev/null; then
    [[ $(mpirun --version 2>&1) != *[Oo]pen* ]] || pmi=pmix
    if [[ $(srun --mpi=list 2>&1) == *$pmi* ]]; then  # wait: so many seconds after the first rank has ended, end all
      exec srun --mpi=$pmi --wait=30 ${SLURM_STEP_ID:+--overlap} ${ranks:+-n "$ranks"} "$@"
    fi
  fi
  exec mpirun -n "${ranks:-2}" "$@"
}

main() {
  local command=${1:-}
  case $command in
    help | -h) help ;;
    setup) setup; warm_up ;;
    test) setup test; warm_up; exec $PY -m pytest -n 3 "${@:2}" ;;
    lint) setup test; ruff check . && ruff format --check . && mypy ;;
    view) setup; cd "$HERE"; exec particles-mpi "$@" ;;  # one process reads files
    doctor) setup; exec particles-mpi doctor ;;  # alone, so that it can try a start on two ranks itself
    '') setup; warm_up; launch $PY -m particles_mpi run particles_mpi/scenes/marbles.toml --output out/marbles --overwrite ;;
    *) setup; warm_up; cd "$HERE"; launch "$VENV/bin/python" -m particles_mpi "$@" ;;
  esac
}

main "$@"
