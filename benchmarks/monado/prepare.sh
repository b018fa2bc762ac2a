#!/bin/sh
# prepare.sh FOLDER: a Debian 13 in FOLDER with Monado, built from Debian's sources with its North Star driver,
# which Debian's own binary lacks. For root; needs debootstrap, network, 2.5 GB, and about ten minutes of one core.
# May be repeated: what is there is kept. Nothing outside FOLDER is written.
set -eu
here=$(dirname "$(readlink -f "$0")")
mkdir -p "$1"
root=$(readlink -f "$1")
[ -e "$root/etc/debian_version" ] || debootstrap --variant=minbase trixie "$root"
cp /etc/resolv.conf "$root/etc/resolv.conf"
grep -q '^deb-src' "$root/etc/apt/sources.list" || sed -n 's/^deb /deb-src /p' "$root/etc/apt/sources.list" >>"$root/etc/apt/sources.list"
"$here/enter.sh" "$root" sh -eu <<'INSIDE'
export DEBIAN_FRONTEND=noninteractive
apt-get update -q
# The runtime that clients load, what draws without a GPU, a screen in memory; then what the build needs. CMake stops at
# OpenGL::GLX without the three GL packages.
apt-get install -q -y --no-install-recommends libopenxr1-monado libopenxr-loader1 mesa-vulkan-drivers libegl1 libegl-mesa0 \
    libgl1-mesa-dri xvfb python3 python3-numpy dpkg-dev g++ cmake ninja-build pkgconf glslang-tools libvulkan-dev libeigen3-dev \
    libx11-xcb-dev libxcb-randr0-dev libxrandr-dev libxxf86vm-dev libudev-dev libbsd-dev libsystemd-dev libglvnd-dev \
    libopengl-dev libglx-dev libegl-dev libgl-dev
mkdir -p /opt/monado
cd /opt/monado
# The original sources, by the hash in Debian's signed index. Debian's own patches are not applied.
ls -d monado-*/ >/dev/null 2>&1 || { apt-get source -q --tar-only monado && tar xf monado_*.orig.tar.xz; }
cd monado-*/
cmake -G Ninja -S . -B build -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF -DXRT_FEATURE_SERVICE=ON >build.log 2>&1 || { tail -30 build.log; exit 1; }
off=$(sed -n 's/^\(XRT_BUILD_DRIVER_[A-Z0-9_]*\):BOOL=.*/-D\1=OFF/p' build/CMakeCache.txt)
cmake -S . -B build $off -DXRT_BUILD_DRIVER_NS=ON >>build.log 2>&1 || { tail -30 build.log; exit 1; }
ninja -C build monado-service >>build.log 2>&1 || { tail -30 build.log; exit 1; }
INSIDE
# The host's pip, as it has the host's certificates: Debian 13 has Python 3.13.
python3 -m pip install -q --target "$root/opt/client" --upgrade --python-version 3.13 --only-binary=:all: \
    pyopenxr==1.1.6501 moderngl==5.12.0
