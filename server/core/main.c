// SPDX-License-Identifier: MIT
// relightd: the order of starting, the loop, and the order of stopping.
#include "core/configuration.h"
#include "core/events.h"
#include "net/carrier.h"
#include "jobs/decode_helper.h"
#include "net/dispatch.h"
#include "store/eviction.h"
#include "core/log.h"
#include "core/log_format.h"
#include "core/notify.h"
#include "core/access.h"
#include "core/tls.h"
#include "core/token.h"
#include "store/holds.h"
#include "store/models.h"
#include "store/readiness.h"
#include "relight.pb-c.h"
#include "net/proxy_peer.h"
#include "net/request.h"
#include "core/server.h"
#include "render/shared/poses.h"
#include "ops/shared_models.h"
#include "render/shared/warm_up.h"
#include "rooms/copy.h"
#include "rooms/rooms.h"

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <malloc.h>
#include <signal.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

static struct server server;
static struct loop_timer drain_timer, lame_duck_timer, maintenance_timer;
static int arg_count;
static char **args;
static bool give_up;

static void drain_over(struct loop_timer *timer)
{
    give_up = true;
}

// Open requests end, new ones are refused.
static void begin_drain(void)
{
    loop_timer_stop(server.loop, &lame_duck_timer);
    __atomic_store_n(&server.draining, true, __ATOMIC_RELAXED); // threads read it
    notify_stopping(&server);
    log_line(LOG_EVENT, "drain requests=%u jobs=%u", server.n_request, jobs_open(server.jobs));
    sockets_close(&server);
    connections_goaway(&server, server.options.drain, server.options.goaway_address,
                       "the daemon is stopping");
    jobs_stop(server.jobs);
    // Watches and views do not end by themselves.
    for (struct connection *c = server.connections, *next; c; c = next) {
        next = c->next;
        for (struct request *r = c->requests, *after; r && !c->dead; r = after) {
            after = r->next;
            if (operation_of(r->type)->flags & OPERATION_ENDS_AT_DRAIN)
                request_stop(r, RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN,
                             "the daemon is stopping");
        }
    }
    drain_timer.fire = drain_over;
    loop_timer_set(server.loop, &drain_timer,
                   loop_now_ns() + (uint64_t)(server.options.drain * 1e9));
}

static void lame_duck_over(struct loop_timer *timer)
{
    begin_drain();
}

// SIGTERM or SIGINT. First clients are told to leave, and are served all the same; a proxy
// finds /readyz failing. Then open requests end. A further signal skips the rest of either.
static void leave(int signal_number)
{
    const struct options *o = &server.options;
    bool first = !server.leaving;
    server.leaving = true;
    if (first) log_line(LOG_EVENT, "leave signal=%s", strsignal(signal_number));
    if (server.draining) {
        give_up = true;
    } else if (first && o->lame_duck > 0) {
        notify_stopping(&server);
        connections_goaway(&server, o->lame_duck + o->drain, o->goaway_address,
                           "the daemon is about to stop");
        lame_duck_timer.fire = lame_duck_over;
        loop_timer_set(server.loop, &lame_duck_timer,
                       loop_now_ns() + (uint64_t)(o->lame_duck * 1e9));
    } else {
        begin_drain();
    }
}

static void on_signal(void *user, int signal_number)
{
    if (signal_number == SIGHUP) {
        notify_reloading();
        bool required = access_required(server.access);
        configuration_reload(&server, arg_count, args);
        // Those of an earlier token, and without one where the first has come.
        connections_recheck(&server, !required && access_required(server.access));
        notify_reloaded(&server);
        return;
    }
    if (signal_number != SIGCHLD) {
        leave(signal_number);
        return;
    }
    // The only children are bakes and the decode helper.
    int how;
    for (pid_t pid; (pid = waitpid(-1, &how, WNOHANG)) > 0;)
        if (!jobs_reap(server.jobs, pid, how)) decoder_reap(server.decoder, pid);
}

static void run_maintenance(struct loop_timer *timer)
{
    blobs_maintain(server.blobs);
    models_keep_pages(&server);
    if (server.models) evict_for_room(&server, NULL, NULL);
    if (server.rooms) rooms_maintain(server.rooms);
    loop_timer_set(server.loop, timer, loop_now_ns() + 60000000000u);
}

static void make_room_for_blob(void *user, const char *owner)
{
    if (server.models) evict_for_room(&server, NULL, owner);
}

static int make_folder(const char *name)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", server.data, name);
    if (!mkdir(path, 0700) || errno == EEXIST) return 0;
    log_line(LOG_ERR, "data folder %s: %s", path, strerror(errno));
    return -1;
}

static int open_data(void)
{
    const char *wanted = server.options.data;
    char temporary[] = "/tmp/relightd-XXXXXX", path[PATH_MAX];
    if (!wanted[0]) {
        wanted = mkdtemp(temporary);
        server.data_temporary = true;
    } else if (mkdir(wanted, 0700) && errno != EEXIST) {
        wanted = NULL;
    }
    if (!wanted || !realpath(wanted, path) || strlen(path) >= sizeof server.data - 100) {
        log_line(LOG_ERR, "data folder %s: %s", server.options.data, strerror(errno));
        return -1;
    }
    strcpy(server.data, path);
    // A second daemon on the same folder would delete the first one's files.
    char lock[4096];
    snprintf(lock, sizeof lock, "%s/lock", server.data);
    int fd = open(lock, O_CREAT | O_RDWR | O_CLOEXEC, 0600);
    struct flock whole = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
    if (fd < 0 || fcntl(fd, F_SETLK, &whole)) {
        log_line(LOG_ERR, "data folder %s: %s", server.data,
                 fd < 0 ? strerror(errno) : "another relightd uses it");
        return -1;
    }
    if (make_folder("blobs") || make_folder("bakes") || make_folder("models") ||
        make_folder("work") || make_folder("jobs") || make_folder("previews"))
        return -1;
    snprintf(path, sizeof path, "%s/blobs", server.data);
    struct blobs_setup setup = {.folder = path,
                                .max_blob = server.options.max_blob,
                                .ledger = server.ledger,
                                .objects = server.objects,
                                .holds = server.holds,
                                .work = server.work,
                                .make_room = make_room_for_blob,
                                .keep_s = 600,
                                .idle_s = 600,
                                .wanted_s = 60};
    int err = blobs_open(&setup, &server.blobs);
    if (err) log_line(LOG_ERR, "data folder %s: %s", path, strerror(-err));
    return err;
}

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    return remove(path);
}

static int check_all(void)
{
    char fault[256];
    const char *advice = configuration_advice(&server.options);
    if (configuration_check(&server.options, fault)) {
        log_line(LOG_ERR, "%s", fault);
        return -1;
    }
    if (advice) log_line(LOG_WARN, "%s", advice);
    return 0;
}

static int open_tls(void)
{
    char fault[256], certificate[256];
    const struct options *o = &server.options;
    if (!o->tls_cert[0]) return 0;
    if (tls_create(o->tls_cert, o->tls_key, &server.tls, fault)) {
        log_line(LOG_ERR, "%s", fault);
        return -1;
    }
    tls_describe(server.tls, certificate, sizeof certificate);
    log_line(LOG_EVENT, "tls certificate=\"%s\"", certificate);
    return 0;
}

static int open_access(void)
{
    char fault[256], token[TOKEN_ROOM] = "";
    const char *path = server.options.token_file;
    if (!access_create(&server.options, server.data, &server.access, fault) &&
        (!path[0] || !token_read(path, token, fault))) {
        access_set_default(server.access, token);
        ledger_set_quotas(server.ledger, access_quotas, server.access);
        return 0;
    }
    log_line(LOG_ERR, "%s", fault);
    return -1;
}

// Each connection is a descriptor. The soft limit is often 1024 because of select(), which the
// daemon does not use. More than 65536 would only enlarge libwebsockets' tables.
static void raise_file_limit(void)
{
    enum { BESIDE = 256 }; // files, children's pipes, HTTP clients
    struct rlimit limit;
    uint64_t wanted = (uint64_t)server.options.connections + BESIDE;
    if (getrlimit(RLIMIT_NOFILE, &limit)) return;
    rlim_t most = wanted > 65536 ? wanted : 65536;
    if (limit.rlim_cur < most) {
        limit.rlim_cur = limit.rlim_max < most ? limit.rlim_max : most;
        setrlimit(RLIMIT_NOFILE, &limit);
        getrlimit(RLIMIT_NOFILE, &limit);
    }
    if (limit.rlim_cur < wanted)
        log_line(LOG_WARN,
                 "--connections %u needs %llu open files, and the limit is %llu: raise it "
                 "(LimitNOFILE=, ulimit -Hn) or lower --connections",
                 server.options.connections, (unsigned long long)wanted,
                 (unsigned long long)limit.rlim_cur);
}

static int listen_everywhere(void)
{
    int n = sd_listen_fds(1);
    for (int i = 0; i < n; i++)
        if (sockets_adopt(&server, SD_LISTEN_FDS_START + i)) return -1;
    if (n <= 0)
        for (unsigned i = 0; i < server.options.n_listen; i++)
            if (sockets_listen(&server, server.options.listen[i])) return -1;
    return server.options.http[0] ? http_open(&server, server.options.http) : 0;
}

// Cursors of events and ids of jobs of another run are recognised by it.
static int choose_run(void)
{
    uint64_t digits;
    if (getrandom(&digits, sizeof digits, 0) != sizeof digits) return -1;
    snprintf(server.run, sizeof server.run, "%016llx", (unsigned long long)digits);
    return 0;
}

// What replicas share; with one machine an empty implementation of the same.
static int open_objects(void)
{
    char fault[256];
    if (object_store_open(server.options.store, &server.objects, fault)) {
        log_line(LOG_ERR, "%s", fault);
        return -1;
    }
    double ahead_s = object_store_clock(server.objects);
    if (fabs(ahead_s) > 30)
        log_line(
            LOG_WARN,
            "this machine's clock is %.0f s %s that of --store: tokens, links and invitations "
            "end so much %s here than at other replicas; set it by NTP",
            fabs(ahead_s), ahead_s > 0 ? "ahead of" : "behind",
            ahead_s > 0 ? "earlier" : "later");
    return 0;
}

static int start_models(void)
{
    if (jobs_recall(server.jobs) || models_create(&server, &server.models)) return -1;
    models_resume_bakes(server.models);
    if (models_follow_folder(&server)) return -1;
    models_start(server.models);
    return shared_models_create(&server, &server.shared_models);
}

static int start(void)
{
    static const int signals[] = {SIGTERM, SIGINT, SIGCHLD, SIGHUP};
    enum { N_SIGNAL = sizeof signals / sizeof *signals };
    const struct options *o = &server.options;
    unsigned cpu = prt_cpu_detect();
    int level = log_level_parse(o->log);
    if (level < 0 || (o->cpu[0] && prt_cpu_parse(o->cpu, &cpu))) {
        fprintf(stderr, "relightd: --%s\n",
                level < 0 ? "log: error, warning, event or trace"
                          : "cpu: one of " PRT_CPU_WORDS);
        exit(2);
    }
    log_set_level((enum log_level)level);
    server.access_level = log_level_parse(o->log_access);
    long cores = sysconf(_SC_NPROCESSORS_ONLN);
    server.n_core = cores > 0 ? (unsigned)cores : 1;
    server.stats.start_ns = loop_now_ns();
    signal(SIGPIPE, SIG_IGN);
    prt_file_guard_maps();
    signal(SIGXFSZ, SIG_IGN); // past RLIMIT_FSIZE a write fails with EFBIG, like on a full disk
    raise_file_limit();
    // Images and planes of a few MB are allocated and freed often: malloc keeps their pages.
    mallopt(M_MMAP_THRESHOLD, 32 << 20);
    mallopt(M_TRIM_THRESHOLD, 256 << 20);
    unsigned threads = o->threads ? o->threads : server.n_core;
    drain_init(&server.drain, threads);
    const struct decoder_limits decoding = {o->decode_memory, o->decode_total, o->cache};
    if (o->accept_weak_sandbox) setenv(PRT_ACCEPT_WEAK_SANDBOX, "1", 1); // for all children
    if (!(server.ledger = ledger_create(o)) || check_all() || choose_run() ||
        events_create(SERVER_EVENTS, &server.events) || loop_create(&server.loop) ||
        loop_signals(server.loop, signals, N_SIGNAL, on_signal, NULL) ||
        cache_create(o->cache, &server.cache) || cache_create(o->memory, &server.files) ||
        !(server.holds = holds_create()) ||
        decoder_create(server.loop, &decoding, &server.stats.children_crashed,
                       &server.decoder) ||
        work_pool_create(server.loop, threads, cpu, &server.work) || open_objects() ||
        open_data() || open_access() || open_tls() || poses_create(&server, &server.poses) ||
        jobs_create(&server,
                    object_store_shared(server.objects) ? &job_runner_shared
                                                        : &job_runner_child,
                    &server.jobs) ||
        start_models() || rooms_create(&server, &server.rooms))
        return -1;
    readiness_begin(&server);
    if (listen_everywhere()) return -1;
    cache_hold_files(server.cache, server.files);
    cache_use_workers(server.cache, server.work);
    cache_use_workers(server.files, server.work);
    maintenance_timer.fire = run_maintenance;
    run_maintenance(&maintenance_timer);
    log_line(LOG_EVENT, "start version=" RELIGHT_VERSION " pid=%d threads=%u data=%s%s",
             (int)getpid(), threads, server.data, server.data_temporary ? " (temporary)" : "");
    warm_start(server.work);
    notify_ready(&server);
    return 0;
}

static bool drained(void)
{
    if (!server.draining) return false;
    if (give_up) return true;
    if (server.n_request || jobs_open(server.jobs)) return false;
    for (const struct connection *c = server.connections; c; c = c->next)
        if (c->out) return false;
    return true;
}

static void stop(void)
{
    if (server.loop) sockets_close(&server);
    while (server.connections) connection_close(server.connections, "the daemon stops");
    http_close();
    proxy_peers_close(&server);
    connections_free_closed(&server);
    // Running work completes without waiters; then everything is released.
    decoder_destroy(server.decoder);
    server.decoder = NULL;
    imports_stop(server.imports);
    uint64_t patience = loop_now_ns() + 20000000000u;
    while (server.work && work_busy(server.work)) {
        if (loop_now_ns() > patience) { // no data is lost, only memory is not freed
            log_line(LOG_WARN, "stop while work is still running");
            log_stop();
            _exit(0);
        }
        loop_turn(server.loop, 50);
    }
    shared_models_destroy(server.shared_models);
    rooms_destroy(server.rooms);
    if (server.cache) cache_use_workers(server.cache, NULL);
    if (server.files) cache_use_workers(server.files, NULL);
    work_pool_destroy(server.work);
    models_unfollow_folder(&server);
    models_destroy(server.models);
    cache_destroy(server.cache); // shapes hold files and poses
    poses_destroy(server.poses);
    cache_destroy(server.files);
    jobs_destroy(server.jobs);
    blobs_close(server.blobs);
    holds_destroy(server.holds);
    object_store_close(server.objects);
    ledger_destroy(server.ledger);
    access_destroy(server.access);
    tls_destroy(server.tls);
    events_destroy(server.events);
    loop_destroy(server.loop);
    if (server.data_temporary && server.data[0] &&
        nftw(server.data, remove_one, 16, FTW_DEPTH | FTW_PHYS))
        log_line(LOG_WARN, "temporary data folder %s could not be removed", server.data);
}

static int print_check(void)
{
    char fault[256];
    if (configuration_check(&server.options, fault)) {
        fprintf(stderr, "relightd: %s\n", fault);
        return 2;
    }
    const char *advice = configuration_advice(&server.options);
    if (advice) fprintf(stderr, "relightd: %s\n", advice);
    printf("relightd: the configuration is fine\n");
    return 0;
}

int main(int argc, char **argv)
{
    if (argc == 3 && !strcmp(argv[1], "--decode-helper"))
        return decode_helper_main(atoi(argv[2]));
    for (int fd = 0; fd < 3; fd++) // descriptors 0 to 2 must not be reused: children get them
        if (fcntl(fd, F_GETFD) < 0 && open("/dev/null", O_RDWR) < 0) return 1;
    arg_count = argc;
    args = argv;
    options_parse(argc, argv, &server.options);
    if (server.options.check) return print_check();
    if (server.options.copy_rooms[0])
        return rooms_copy(server.options.copy_rooms, server.options.rooms);
    int format = log_format_parse(server.options.log_format);
    log_set_format(format < 0 ? LOG_FORMAT_TEXT : format);
    log_start();
    int failed = start();
    while (!failed && !drained()) {
        if (http_is_open()) http_turn(&server);
        else loop_turn(server.loop, -1);
        connections_shed(&server);
        connections_free_closed(&server);
    }
    if (failed) log_line(LOG_ERR, "start failed: see the errors above");
    stop();
    if (!failed) log_line(LOG_EVENT, "stop");
    log_stop();
    return failed ? 1 : 0;
}
