#!/usr/bin/python3
# SPDX-License-Identifier: MIT
"""The shared folder on NFS, with the server and the clients of Linux: a User Mode Linux runs as an ordinary process, exports
a folder, and mounts it twice, as two machines with caches of their own do (NFS 4.1 and 4.2). In it a test runs whose stores
or replicas use the mounts in turn (RELIGHT_TEST_MOUNTS). Skipped where user-mode-linux is not installed.

   nfs.py BUILD_FOLDER COMMAND      in COMMAND, BUILD and TESTS stand for the folders of the build and of the tests"""
import ctypes
import fcntl
import glob
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
MOUNTS = {"/tmp/one": "4.1", "/tmp/two": "4.2"}
EXPORT = "/tmp/export"
MODULES = ("nfsd", "nfsv4")
END = "the first process ends: %d"


# ---- in the User Mode Linux, as its first process

LIBC = ctypes.CDLL(None, use_errno=True)
FINIT_MODULE, COMPRESSED = 313, 4  # of x86-64, which User Mode Linux is


def fault(what):
    raise OSError(ctypes.get_errno(), "%s: %s" % (what, os.strerror(ctypes.get_errno())))


def mount(what, where, kind, data=""):
    os.makedirs(where, exist_ok=True)
    if LIBC.mount(what.encode(), where.encode(), kind.encode(), 0, data.encode()):
        fault("mount %s at %s" % (what, where))


def insert_modules(folder):
    needs = {}
    with open(folder + "/modules.dep", encoding="ascii") as f:
        for line in f:
            path, _, before = line.partition(":")
            needs[os.path.basename(path).partition(".ko")[0]] = [path, *before.split()]
    done = set()
    for name in MODULES:
        for path in reversed(needs[name]):
            if path in done:
                continue
            done.add(path)
            with open(folder + "/" + path, "rb") as f:
                if LIBC.syscall(FINIT_MODULE, f.fileno(), b"", 0 if path.endswith(".ko") else COMPRESSED):
                    fault(path)


def loopback_up():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        fcntl.ioctl(s, 0x8914, struct.pack("16sh14x", b"lo", 1))  # SIOCSIFFLAGS, IFF_UP


def write(path, text):
    fd = os.open(path, os.O_WRONLY)
    try:
        os.write(fd, text.encode())
    except OSError as error:
        raise OSError(error.errno, "%s: %s" % (path, error.strerror)) from error
    finally:
        os.close(fd)


def serve(folder):
    """Exports the folder as the root of NFS 4, by what exportfs and rpc.mountd would tell the kernel."""
    never = 0x7fffffff
    flags = 0x0002 | 0x0400 | 0x2000  # insecure ports, no check of subtrees, its number is 0
    mount("nfsd", "/proc/fs/nfsd", "nfsd")
    write("/proc/fs/nfsd/versions", "-2 -3 +4 +4.1 +4.2\n")
    write("/proc/net/rpc/auth.unix.ip/channel", "nfsd 127.0.0.1 %d all\n" % never)
    write("/proc/net/rpc/nfsd.export/channel", "all %s %d %d 65534 65534 0\n" % (folder, never, flags))
    write("/proc/net/rpc/nfsd.fh/channel", "all 1 \\x00000000 %d %s\n" % (never, folder))
    write("/proc/fs/nfsd/nfsv4gracetime", "10\n")
    write("/proc/fs/nfsd/threads", "4\n")



def first_process():
    status = 1
    try:
        os.environ["PATH"] = "/usr/bin:/bin:/usr/sbin:/sbin"
        mount("proc", "/proc", "proc")
        mount("sys", "/sys", "sysfs")
        mount("tmp", "/dev/shm", "tmpfs")
        mount("tmp", "/tmp", "tmpfs")
        for path in os.environ["RELIGHT_FOLDERS"].split(":"):  # of this machine, which /tmp may hide
            mount("none", path, "hostfs", path)
        mount("tmp", EXPORT, "tmpfs")
        insert_modules(os.environ["RELIGHT_MODULES"])
        loopback_up()
        serve(EXPORT)
        for where, version in MOUNTS.items():
            mount("127.0.0.1:/", where, "nfs4", "vers=%s,addr=127.0.0.1,clientaddr=127.0.0.1,nosharecache" % version)
        print("the folder is on NFS: " + ", ".join("%s at %s" % (v, where) for where, v in MOUNTS.items()), flush=True)
        environment = dict(os.environ, RELIGHT_TEST_MOUNTS=" ".join(MOUNTS), HOME="/tmp", PYTHONDONTWRITEBYTECODE="1")
        status = subprocess.run(["/bin/sh", os.environ["RELIGHT_RUN"]], check=False, env=environment).returncode
    except OSError as error:
        print("in the User Mode Linux: %s" % error)
    print(END % status, flush=True)
    write("/proc/sysrq-trigger", "o")
    signal.pause()  # the kernel panics where its first process ends before the power is off


# ---- on this machine

def skip(why):
    print("skipped: %s (deploy/dependencies --cluster)" % why)
    sys.exit(77)


def main():
    linux = shutil.which("linux.uml")
    modules = glob.glob("/usr/lib/uml/modules/*/modules.dep")
    if not linux or not modules:
        skip("no user-mode-linux")
    build = os.path.abspath(sys.argv[1])
    folders = {build, os.path.abspath(HERE + "/../..")}
    # A folder within another is there with it.
    folders = sorted(f for f in folders if not any(f.startswith(other + "/") for other in folders))
    program = sys.argv[2].replace("BUILD", build).replace("TESTS", os.path.dirname(HERE))
    # Spaces and quotes of the kernel's command line are its own: the command goes by a file.
    with tempfile.NamedTemporaryFile("w", prefix="relight-nfs-", dir=build, suffix=".sh") as script:
        script.write(program + "\n")
        script.flush()
        words = ["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", "mem=1G", "quiet", "con=null", "con0=fd:0,fd:1",
                 "init=" + os.path.abspath(__file__), "RELIGHT_MODULES=" + os.path.dirname(modules[-1]),
                 "RELIGHT_FOLDERS=" + ":".join(folders), "RELIGHT_RUN=" + script.name]
        environment = dict(os.environ)
        registers = build + "/bin/libuml_registers.so"  # uml_registers.c
        if os.path.exists(registers):
            environment["LD_PRELOAD"] = registers
        done = subprocess.run([linux, *words], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, errors="replace", check=False).stdout
    print(done)
    if "the folder is on NFS" not in done and "in the User Mode Linux" not in done:
        skip("the User Mode Linux does not start here")
    sys.exit(0 if END % 0 in done else 1)


if os.getpid() == 1:
    first_process()
else:
    main()
