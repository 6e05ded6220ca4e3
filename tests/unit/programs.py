# SPDX-License-Identifier: MIT
"""What tests that run the programs share: a folder of their own, prt and relight, a relightd.
The test's first argument is the folder of the programs, or prt itself."""
import contextlib
import os
import subprocess
import sys
import tempfile
import time

BIN = os.path.abspath(sys.argv[1])
if os.path.isfile(BIN):
    BIN = os.path.dirname(BIN)
failed = []


def expect(good, text):
    if not good:
        failed.append(text)
        print('FAIL: ' + text)


def run(program, *args, status=0):
    """The ended process; .said is what it wrote to both streams."""
    done = subprocess.run([os.path.join(BIN, program), *args], capture_output=True, text=True, timeout=300)
    done.said = done.stdout + done.stderr
    expect(done.returncode == status,
           '%s %s: status %d: %s' % (program, ' '.join(args), done.returncode, done.stderr))
    return done


def prt(*args, status=0):
    return run('prt', *args, status=status)


def relight(*args, status=0, at=''):
    """at: the daemon's."""
    return run('relight', '-s', 'unix:%ssocket' % at, *args, status=status)


def same(got, want, most):
    prt('compare', got, want, '--max-rmse', str(most))


@contextlib.contextmanager
def daemon(*options, at=''):
    """A relightd on ./socket that writes to ./log; at: what these names begin with. Its previews do not change by
    themselves, but with --preview-walks=yes."""
    with open(at + 'log', 'w', encoding='utf-8') as log:
        process = subprocess.Popen([os.path.join(BIN, 'relightd'), '--preview-walks=no', *options, '--listen',
                                    'unix:%ssocket' % at],
                                   stdout=log, stderr=log)
    try:
        for _ in range(1200):
            if os.path.exists(at + 'socket') or process.poll() is not None:
                break
            time.sleep(0.05)
        yield process
    finally:
        process.terminate()
        process.wait(60)
        with open(at + 'log', encoding='utf-8', errors='replace') as log:
            text = log.read()
        # a sanitizer's report, of the daemon or of a child
        expect('Sanitizer: ' not in text and ': runtime error: ' not in text, text)


def main(*tests):
    """Runs the tests in a folder that is removed, and ends the program."""
    with tempfile.TemporaryDirectory(prefix='relight-test-') as folder:
        os.chdir(folder)
        for test in tests:
            test()
        os.chdir('/')
    sys.exit(bool(failed))
