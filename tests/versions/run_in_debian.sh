#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# Builds and tests Amberlight inside other Debian releases, each in a chroot of its own:
#
#     tests/versions/run_in_debian.sh trixie sid bookworm
#
#   trixie    Blender 4.3, Embree 4: C tests, a render of scenes_blend/sphere.blend, tests/blender
#             and, where ../shared/cases is, tests/blender_cases
#   sid       Blender 5, Embree 4: the same
#   bookworm  a bare Debian 12: the two commands that README.md opens with, as root and as a user
#
# What is tested is the last commit. The first word `prepare` only makes the chroots.
# Needs root, debootstrap and some 3 GB a release. Chroots are kept between runs.
#   AMBERLIGHT_CHROOTS   where they live (default: amberlight/chroots in the user's cache folder)
#   AMBERLIGHT_MIRROR    the Debian mirror (default: the one that this machine's apt uses)
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
readonly root
readonly chroots=${AMBERLIGHT_CHROOTS:-${XDG_CACHE_HOME:-$HOME/.cache}/amberlight/chroots}

# What a release needs to build the library and to run its tests; bookworm gets nothing, because
# ./amberlight has to install it.
readonly packages=(
    blender python3-numpy python3-matplotlib python3-pytest xvfb xauth
    cmake ninja-build gcc libc6-dev libembree-dev libopenexr-dev git
)

die() {
    printf 'run_in_debian: %s\n' "$*" >&2
    exit 1
}

say() { printf '\n== %s\n' "$*"; }

# The first Debian archive in this machine's apt sources, in either of apt's two formats.
host_mirror() {
    local sources=(/etc/apt/sources.list /etc/apt/sources.list.d/*)
    grep -hs -v '^[[:space:]]*#' "${sources[@]}" |
        grep -oE '(https?|file)://[^][[:space:]]+/debian/?([[:space:]]|$)' |
        head -n 1 | tr -d '[:space:]'
}

# Proxies and date checks of this machine's apt hold in the chroot too.
host_apt_settings() {
    apt-config dump | grep -E '^Acquire::(https?|Check-|Retries|ForceIPv)' || true
}

# Runs a command inside a chroot, with mounts and processes that end together with it.
inside() {
    local chroot=$1
    shift
    # shellcheck disable=SC2016  # expanded by the inner shell
    unshare --mount --pid --fork -- bash -c '
        chroot=$1; shift
        mount --make-rprivate /
        mount -t proc proc "$chroot/proc"
        mount -t tmpfs tmpfs "$chroot/dev/shm" 2>/dev/null || true
        exec chroot "$chroot" /usr/bin/env -i HOME=/root TERM=dumb LANG=C.UTF-8 \
            PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin "$@"
    ' inside "$chroot" "$@"
}

prepare() {
    local suite=$1 chroot=$chroots/$1 mirror=${AMBERLIGHT_MIRROR:-$(host_mirror)}
    [[ -n $mirror ]] || die "no Debian mirror in /etc/apt/sources.list*: set AMBERLIGHT_MIRROR"
    if [[ ! -e $chroot/.base-ready ]]; then
        say "$suite: debootstrap"
        rm -rf -- "$chroot"
        mkdir -p -- "$chroots"
        debootstrap --variant=minbase "$suite" "$chroot" "$mirror"
        touch -- "$chroot/.base-ready"
    fi
    cp -L -- /etc/resolv.conf "$chroot/etc/resolv.conf"
    cp -L -- /etc/hosts "$chroot/etc/hosts"
    ln -sfn -- /proc/self/mounts "$chroot/etc/mtab"
    host_apt_settings >"$chroot/etc/apt/apt.conf.d/90host"
    local ready=$chroot/.packages-ready
    if [[ $suite != bookworm && $(cat -- "$ready" 2>/dev/null) != "${packages[*]}" ]]; then
        say "$suite: packages"
        inside "$chroot" apt-get -q update
        inside "$chroot" env DEBIAN_FRONTEND=noninteractive \
            apt-get -q -y install --no-install-recommends "${packages[@]}"
        inside "$chroot" apt-get clean
        printf '%s\n' "${packages[*]}" >"$ready"
    fi
}

# The files of the last commit, as a fresh clone has them, and the reference cases beside them.
copy_checkout() {
    local target=$1 cases=$root/../shared/cases
    rm -rf -- "$target"
    mkdir -p -- "$target"
    git -C "$root" archive HEAD | tar -x -C "$target"
    [[ -d $cases ]] || return 0
    rm -rf -- "$target/../shared"
    mkdir -p -- "$target/../shared"
    cp -r -- "$cases" "$target/../shared/"
}

results=()
failures=0
step() {
    local name=$1 start=$SECONDS result=ok
    shift
    say "$name"
    if ! "$@"; then
        result=FAILED
        failures=$((failures + 1))
    fi
    results+=("$(printf '%-44s %-7s %4d s' "$name" "$result" $((SECONDS - start)))")
}

# A shell line in the checkout, as a user of the chroot.
in_checkout() { inside "$1" su -s /bin/bash "$2" -c "cd /amberlight && $3"; }

versions() {
    # shellcheck disable=SC2016  # expanded inside
    in_checkout "$1" root '. /etc/os-release; echo "$PRETTY_NAME"; blender --version | head -n 1
        dpkg-query -W -f "\${Package} \${Version}\n" gcc cmake libembree-dev libopenexr-dev'
}

readonly tiny='samples=1 light_samples=2000 scene.render.resolution_percentage=12'

# Other versions of Blender and Embree.
run_matrix() {
    local suite=$1 chroot=$chroots/$1
    copy_checkout "$chroot/amberlight"
    step "$suite: versions" versions "$chroot"
    step "$suite: build" in_checkout "$chroot" root './amberlight build'
    step "$suite: C tests" in_checkout "$chroot" root \
        'cmake --preset dev && cmake --build --preset dev && ctest --preset dev'
    step "$suite: render" in_checkout "$chroot" root \
        "./amberlight render scenes_blend/sphere.blend $tiny && ls -l out"
    step "$suite: tests/blender" in_checkout "$chroot" root \
        'python3 -m pytest -q tests/blender tests/blender_cases'
}

# The first line of what a user without rights is told when packages are missing.
refusal() {
    local said
    said=$(in_checkout "$1" tester './amberlight render scenes_blend/sphere.blend' 2>&1) && return 1
    printf '%s\n' "$said"
    [[ $said == *"apt-get install"* && $(wc -l <<<"$said") -eq 1 ]]
}

# The two commands on a machine that has nothing but Debian's base system.
run_bare() {
    local suite=$1 chroot=$chroots/$1-bare
    rm -rf -- "$chroot"
    cp -a --reflink=auto -- "$chroots/$suite" "$chroot"
    copy_checkout "$chroot/amberlight"
    inside "$chroot" useradd --create-home tester
    step "$suite: user, packages missing" refusal "$chroot"
    step "$suite: root, render" in_checkout "$chroot" root \
        './amberlight render scenes_blend/bumpy_sphere.blend effects=MANUAL && ls -l out'
    step "$suite: versions" versions "$chroot"
    step "$suite: root, test" in_checkout "$chroot" root './amberlight test'
    copy_checkout "$chroot/amberlight"
    inside "$chroot" chown -R tester /amberlight
    step "$suite: user, render" in_checkout "$chroot" tester \
        "./amberlight render scenes_blend/sphere.blend $tiny && ls -l out"
}

only_prepare=0
if [[ ${1:-} == prepare ]]; then
    only_prepare=1
    shift
fi
(($# > 0)) || die "which of trixie, sid, bookworm?"
((EUID == 0)) || die "chroots need root"
command -v debootstrap >/dev/null || die "debootstrap is missing: apt-get install debootstrap"

for suite; do
    prepare "$suite"
    ((only_prepare)) && continue
    case $suite in
    bookworm) run_bare "$suite" ;;
    *) run_matrix "$suite" ;;
    esac
done
((only_prepare)) && exit

say summary
printf '%s\n' "${results[@]}"
((failures == 0)) || die "$failures of ${#results[@]} steps failed"
