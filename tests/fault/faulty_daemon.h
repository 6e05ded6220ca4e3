// SPDX-License-Identifier: MIT
// A relightd with libfaults.so in it, and what each test does with it.
#ifndef TESTS_FAULT_FAULTY_DAEMON_H
#define TESTS_FAULT_FAULTY_DAEMON_H

#include "daemon.h"
#include "faults.h"

#include <sys/mman.h>

static struct daemon d;
static struct faults *faults;

static inline void faults_setup(void)
{
    char path[128];
    daemon_folder(&d);
    mkdir(d.data, 0700);
    snprintf(path, sizeof path, "%s/faults", d.folder);
    int fd = open(path, O_CREAT | O_RDWR, 0600);
    assert_true(fd >= 0);
    assert_int_equal(ftruncate(fd, sizeof *faults), 0);
    faults = mmap(NULL, sizeof *faults, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    assert_true(faults != MAP_FAILED);
    close(fd);
    snprintf(faults->folder, sizeof faults->folder, "%s", d.data);
    setenv("FAULTS", path, 1);
    setenv("LD_PRELOAD", FAULTS_LIBRARY, 1);
}

static inline int faults_teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

// The next call goes well again.
static inline void faults_off(void)
{
    faults->allocation = 0;
    faults->call = 0;
    faults->kinds = 0;
    faults->lasting = 0;
}

static inline void must_live(const char *after, int64_t n)
{
    int how;
    pid_t gone = waitpid(d.pid, &how, WNOHANG);
    if (gone != d.pid) return;
    d.pid = 0;
    char *text = read_text(d.log);
    size_t size = strlen(text);
    print_message("%s", size > 2000 ? text + size - 2000 : text);
    free(text);
    fail_msg("the daemon ended with %d after fault %lld in %s", how, (long long)n, after);
}

// A client without fault messages: NULL where the connection failed.
static inline struct relight_client *try_connect(void)
{
    struct relight_client *client = NULL;
    struct relight_error error;
    struct relight_options options = {.timeout_s = 20};
    if (relight_connect(d.address, &options, &client, &error)) return NULL;
    return client;
}

#endif
