#!/usr/bin/env bash
# Builds the virtual machine: a Debian kernel with its own drivers, systemd, and what `realitysim install` puts in place.
# build.sh PROGRAM FOLDER [DEB]; the folder keeps what is downloaded. The machine of the long form gets a Debian package to install.
set -euo pipefail
program="$(realpath "$1")"
folder="$(realpath -m "$2")"
deb="${3:+$(realpath "$3")}"
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
mkdir -p "$folder/dl"
cd "$folder"

kernel="$(apt-cache depends linux-image-amd64 | awk '/Depends:/{print $2; exit}')"
version="${kernel#linux-image-}"
if [ ! -e v4l2loopback.ko ]; then
    common="linux-headers-${version%-amd64}-common"
    kbuild="$(apt-cache depends "linux-headers-$version" | awk '/Depends: linux-kbuild/{print $2; exit}')"
    (cd dl && apt-get download -qq "$kernel" "linux-headers-$version" "$common" "$kbuild" v4l2loopback-dkms 2>/dev/null)
    dpkg -x dl/"${kernel}"_*.deb kernel
    depmod -b kernel "$version"
    cp "kernel/boot/vmlinuz-$version" vmlinuz
    # Debian has this driver as source only. Nothing of it touches the machine that builds.
    for package in dl/linux-headers* dl/linux-kbuild* dl/v4l2loopback*; do dpkg -x "$package" headers; done
    sed -i "s# /usr/src# $folder/headers/usr/src#" "headers/usr/src/linux-headers-$version/Makefile"
    source="$(echo "$folder"/headers/usr/src/v4l2loopback-*)"
    make -s -C "headers/usr/src/linux-headers-$version" M="$source" modules >make.log 2>&1 || (cat make.log; false)
    cp "$source/v4l2loopback.ko" .
fi
modules() {
    local module
    for module in "$@"; do
        modprobe -d kernel -S "$version" --show-depends "$module" | awk '$1=="insmod"{print $2}'
    done | awk '!seen[$0]++'
}

# The first steps: the disk's driver, then systemd from there.
initrd="$(mktemp -d)"
mkdir -p "$initrd"/{bin,dev,proc,sys,newroot,lib/modules}
cp /bin/busybox "$initrd/bin/"
modules virtio_pci virtio_blk ext4 | while read -r module; do
    cp "$module" "$initrd/lib/modules/"
    basename "$module" >>"$initrd/lib/modules/order"
done
cat >"$initrd/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin; export PATH=/bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
for module in $(cat /lib/modules/order); do insmod /lib/modules/$module; done
i=0; while [ ! -b /dev/vda ] && [ $i -lt 100 ]; do sleep 0.05; i=$((i+1)); done
mount -t ext4 -o noatime /dev/vda /newroot; umount /proc /sys; mount --move /dev /newroot/dev
exec switch_root /newroot /sbin/init
INIT
chmod +x "$initrd/init"
(cd "$initrd" && find . -print0 | cpio --null -o -H newc --quiet) | gzip -1 >initrd.gz
rm -rf "$initrd"

[ -e base.tar ] || mmdebstrap --mode=root --variant=minbase --include=systemd-sysv,udev,kmod,v4l-utils -q \
    --aptopt='APT::Install-Recommends "false"' --dpkgopt='path-exclude=/usr/share/doc/*' \
    --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/locale/*' bookworm base.tar
root="$folder/root"
rm -rf "$root"
mkdir "$root"
tar -xf base.tar -C "$root"
units="$root/etc/systemd/system"
target="$root/usr/lib/modules/$version"
mkdir -p "$target"
cp kernel/lib/modules/"$version"/modules.{builtin,order,builtin.modinfo} "$target/"
modules vivid videodev virtio_blk ext4 virtio_pci uhci_hcd ftdi_sio virtio_rng | while read -r module; do
    relative="${module##*/$version/}"
    mkdir -p "$target/$(dirname "$relative")"
    cp "$module" "$target/$relative"
done
mkdir -p "$target/extra"
cp v4l2loopback.ko "$target/extra/"
depmod -b "$root" "$version"
printf '%s\n' vivid v4l2loopback >"$root/etc/modules-load.d/camera.conf"
# A webcam, and beside it an input to which the output's frames come (docs/howto/robot.md, virtual machine).
printf '%s\n' 'options vivid n_devs=1 node_types=0x101 num_inputs=2 input_types=0xc num_outputs=1 output_types=1' \
    'options v4l2loopback video_nr=10 exclusive_caps=1 max_buffers=8' >"$root/etc/modprobe.d/camera.conf"

# A root shell on the third serial line, for the test.
printf '%s\n' '[Unit]' DefaultDependencies=no After=systemd-udevd.service '[Service]' ExecStart=/bin/sh \
    StandardInput=tty-force StandardOutput=tty StandardError=tty TTYPath=/dev/ttyS2 Restart=always \
    'Environment=TERM=dumb SYSTEMD_PAGER= SYSTEMD_COLORS=0' >"$units/testshell.service"
mkdir -p "$units"/{multi-user,sysinit}.target.wants
ln -s ../testshell.service "$units/sysinit.target.wants/"
for unit in getty@tty1.service apt-daily.timer apt-daily-upgrade.timer e2scrub_all.timer e2scrub_reap.service \
    fstrim.timer dpkg-db-backup.timer systemd-timesyncd.service systemd-networkd.service systemd-networkd.socket \
    systemd-logind.service dbus.service dbus.socket systemd-remount-fs.service systemd-update-utmp.service \
    systemd-random-seed.service; do
    ln -sf /dev/null "$units/$unit"
done
ln -sf /lib/systemd/system/multi-user.target "$units/default.target"
# The captures have a disk of their own: it is looked at after the power was cut, and it can be filled.
echo '/dev/vdb /var/lib/realitysim ext4 noatime,nofail 0 0' >"$root/etc/fstab"
echo testvm >"$root/etc/hostname"
echo 0123456789abcdef0123456789abcdef >"$root/etc/machine-id"

# As on a robot.
"$program" install --root "$root"
cp "$here/robot.toml" "$root/etc/realitysim/robot.toml"
install -m755 "$here"/guest/* "$root/usr/local/bin/"
[ -z "$deb" ] || cp "$deb" "$root/opt/realitysim.deb"
# vivid is no USB camera, and the 16550 has no udev name: two more rules name them.
cat >"$root/etc/udev/rules.d/99-testvm.rules" <<'RULES'
SUBSYSTEM=="video4linux", ATTR{name}=="vivid-*-vid-cap", SYMLINK+="robot-camera"
SUBSYSTEM=="tty", KERNEL=="ttyS1", SYMLINK+="robot-mcu"
RULES
ln -s /usr/lib/systemd/system/realitysim.service "$units/multi-user.target.wants/"

rm -f root.img root.qcow2
mke2fs -q -t ext4 -d "$root" root.img 700M
qemu-img convert -O qcow2 root.img root.qcow2
rm -rf "$root" root.img
