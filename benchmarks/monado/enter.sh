#!/bin/sh
# enter.sh FOLDER COMMAND...: run a command as root in the Debian system in FOLDER. Mounts and processes are the command's
# own and end with it.
set -eu
exec unshare --mount --pid --fork --kill-child sh -eu -c '
root=$1
shift
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/tmp"
exec chroot "$root" "$@"' enter "$@"
