#!/usr/bin/env bash
# Installs, runs, removes and purges the Debian package in a fresh Debian 12: check_deb.sh DEB. Needs root and mmdebstrap.
set -euo pipefail
deb="$(realpath "$1")"

say() { printf 'check_deb: %s\n' "$*" >&2; }
fail() { say "$*" && exit 1; }

# The address is a placeholder until there is a public one, Debian's own archive is not meant, and `realitysim install` looks whether dpkg
# has the program. Nothing else may be found.
if command -v lintian >/dev/null; then
    lintian --allow-root --fail-on error,warning \
        --suppress-tags bogus-mail-host,bogus-mail-host-in-debian-changelog,initial-upload-closes-no-bugs,uses-dpkg-database-directly "$deb"
else
    say "there is no lintian: not judged by it"
fi
if [ "$(id -u)" -ne 0 ] || ! command -v mmdebstrap >/dev/null; then
    say "not root, or no mmdebstrap (apt-get install mmdebstrap): installing was not tried"
    exit 0
fi
root="$(mktemp -d)"
trap 'rm -rf "$root"' EXIT
mmdebstrap --mode=root --variant=minbase --include=udev,systemd -q bookworm "$root"
cp "$deb" "$root/realitysim.deb"
inside() { chroot "$root" env DEBIAN_FRONTEND=noninteractive PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"; }
files() { (cd "$root" && find etc usr var/lib/realitysim -path usr/lib/sysimage -prune -o -print 2>/dev/null | grep -i realitysim || true); }

# An older distribution: dpkg believes that glibc is of Debian 9.
cp "$root/var/lib/dpkg/status" "$root/status.true"
sed -i '/^Package: libc6$/,/^$/s/^Version: .*/Version: 2.24-11/' "$root/var/lib/dpkg/status"
if said="$(inside dpkg --install /realitysim.deb 2>&1)"; then fail "an older distribution takes the package"; fi
[[ "$said" == *"libc6 (>= 2.28)"* ]] || fail "the refusal does not name what is missing: $said"
[ -z "$(files)" ] || fail "the refused package left: $(files)"
inside dpkg --audit | grep -q . && fail "the refused package is half-installed"
mv "$root/status.true" "$root/var/lib/dpkg/status"
say "an older distribution refuses it: $(grep -m 1 'libc6' <<<"$said")"

inside dpkg --install /realitysim.deb
inside realitysim --version
inside realitysim replay --help >/dev/null
for file in lib/systemd/system/realitysim.service lib/udev/rules.d/99-realitysim.rules share/man/man1/realitysim-replay.1.gz \
    share/bash-completion/completions/realitysim; do
    [ -s "$root/usr/$file" ] || fail "/usr/$file is missing"
done
inside getent passwd realitysim >/dev/null || fail "the user is missing"
# As the next boot does. The mount is gone with its namespace.
unshare --mount sh -c 'mount --bind /proc "$1/proc" && chroot "$1" systemd-tmpfiles --create realitysim.conf' sh "$root"
[ "$(inside stat -c '%U:%G %a' /var/lib/realitysim/captures)" = "realitysim:realitysim 2770" ] || fail "the folder of captures is wrong"
[ ! -e "$root/etc/systemd/system/multi-user.target.wants/realitysim.service" ] || fail "the service was enabled"
inside realitysim install && fail "install writes over the files of dpkg"

# A config that was edited survives an upgrade and a removal; a capture survives everything.
echo '# ours' >>"$root/etc/realitysim/robot.toml"
mkdir "$root/var/lib/realitysim/captures/a-session"
touch "$root/var/lib/realitysim/captures/last_state.bin"
inside dpkg --install /realitysim.deb
grep -q ours "$root/etc/realitysim/robot.toml" || fail "an upgrade lost the config"
inside dpkg --remove realitysim
[ ! -e "$root/usr/bin/realitysim" ] || fail "the program outlives its removal"
grep -q ours "$root/etc/realitysim/robot.toml" || fail "a removal lost the config"
inside dpkg --purge realitysim
[ -d "$root/var/lib/realitysim/captures/a-session" ] || fail "a purge removed a capture"
inside getent passwd realitysim >/dev/null || fail "a purge removed the owner of a capture"
rmdir "$root/var/lib/realitysim/captures/a-session"
inside dpkg --install /realitysim.deb
inside dpkg --purge realitysim
[ -z "$(files)" ] || fail "the purge left: $(files)"
if inside getent passwd realitysim; then fail "the purge left the user"; fi
say "installed, run, removed and purged: nothing is left but captures"
