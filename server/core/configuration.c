// SPDX-License-Identifier: MIT
// The configuration as a whole: checking it, and reading it again.
#include "core/proxy_header.h"
#include "core/configuration.h"

#include "core/access.h"
#include "core/address.h"
#include "core/log.h"
#include "core/log_format.h"
#include "core/tls.h"
#include "core/token.h"
#include "prt/base.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int check_folder(const char *word, const char *path, char fault[256])
{
    struct stat st;
    const char *why = NULL;
    if (!path[0]) return 0;
    if (stat(path, &st)) why = strerror(errno);
    else if (!S_ISDIR(st.st_mode)) why = "not a folder";
    else if (access(path, R_OK | X_OK)) why = strerror(errno);
    if (!why) return 0;
    snprintf(fault, 256, "--%s %.180s: %s", word, path, why);
    return -1;
}

// The data folder may be absent: the daemon creates it.
static int check_data(const char *path, char fault[256])
{
    struct stat st;
    char parent[PATH_MAX];
    if (!path[0]) return 0;
    if (!stat(path, &st)) {
        if (check_folder("data", path, fault)) return -1;
        if (!access(path, W_OK)) return 0;
    } else {
        snprintf(parent, sizeof parent, "%s", path);
        size_t n = strlen(parent);
        while (n > 1 && parent[n - 1] == '/') parent[--n] = 0;
        char *slash = strrchr(parent, '/');
        if (!slash) strcpy(parent, ".");
        else slash[slash == parent] = 0;
        if (!access(parent, W_OK | X_OK)) return 0;
    }
    snprintf(fault, 256, "--data %.180s: %s", path, strerror(errno));
    return -1;
}

// The daemon deletes unknown files in its own folders: a models folder must not be one of them.
static int check_apart(const struct options *options, char fault[256])
{
    static const char *const own[] = {"", "/blobs", "/bakes", "/models", "/work", "/previews"};
    char models[PATH_MAX], data[PATH_MAX];
    if (!options->models[0] || !options->data[0] || !realpath(options->models, models) ||
        !realpath(options->data, data))
        return 0;
    size_t n = strlen(data);
    for (size_t i = 0; i < sizeof own / sizeof *own; i++)
        if (!strncmp(models, data, n) && !strcmp(models + n, own[i])) {
            snprintf(fault, 256,
                     "--models %.150s: the daemon keeps its own files there; models need a "
                     "folder outside --data",
                     options->models);
            return -1;
        }
    return 0;
}

static int check_words(const struct options *options, char fault[256])
{
    unsigned cpu;
    const char *why = NULL;
    if (log_level_parse(options->log) < 0) why = "--log: error, warning, event or trace";
    else if (log_format_parse(options->log_format) < 0)
        why = "--log-format: text, logfmt or json";
    else if (strcmp(options->log_access, "event") && strcmp(options->log_access, "trace"))
        why = "--log-access: event or trace";
    else if (options->cpu[0] && prt_cpu_parse(options->cpu, &cpu))
        why = "--cpu: one of " PRT_CPU_WORDS;
    if (!why && strcmp(options->runner, "local") && strcmp(options->runner, "slurm"))
        why = "--runner: local or slurm";
    if (!why && !options->replicas[0] != !options->advertise[0])
        why = "--replicas and --advertise: each needs the other";
    const char *away = options->goaway_address;
    if (away[0] && strncmp(away, "tcp:", 4) && strncmp(away, "tls:", 4) &&
        strncmp(away, "unix:", 5))
        why = "--goaway-address: expected tcp:HOST:PORT, tls:HOST:PORT or unix:PATH";
    if (!why) return 0;
    snprintf(fault, 256, "%s", why);
    return -1;
}

static int check_addresses(const struct options *options, char fault[256])
{
    char http[300], why[256];
    snprintf(http, sizeof http, "http:%s", options->http);
    for (unsigned i = 0; i <= options->n_listen; i++) {
        bool last = i == options->n_listen;
        const char *address = last ? http : options->listen[i];
        if ((last && !options->http[0]) || !address_check(options, address, why)) continue;
        snprintf(fault, 256, "listen %.100s: %.140s", address, why);
        return -1;
    }
    return 0;
}

static int check_tls(const struct options *options, char fault[256])
{
    struct tls *tls = NULL;
    int failed =
        options->tls_cert[0] ? tls_create(options->tls_cert, options->tls_key, &tls, fault) : 0;
    tls_destroy(tls);
    return failed;
}

static int check_proxies(const struct options *options, char fault[256])
{
    char why[128];
    if (proxy_list_check(options->proxies, why)) return 0;
    snprintf(fault, 256, "--proxies: %s", why);
    return -1;
}

int configuration_check(const struct options *options, char fault[256])
{
    char token[TOKEN_ROOM];
    if (check_words(options, fault) || check_folder("models", options->models, fault) ||
        check_folder("page", options->page, fault) || check_data(options->data, fault) ||
        check_apart(options, fault) || check_addresses(options, fault))
        return -1;
    if (check_tls(options, fault) || check_proxies(options, fault)) return -1;
    return options->token_file[0] ? token_read(options->token_file, token, fault) : 0;
}

const char *configuration_advice(const struct options *options)
{
    bool embedded = !options->rooms[0] || !strncmp(options->rooms, "sqlite:", 7);
    if (options->store[0] && embedded)
        return "--store with rooms in SQLite: other relightd of this folder do not see these "
               "rooms; where there are several, use --rooms postgresql://[USER@]HOST/DATABASE";
    return NULL;
}

static unsigned n_taken, n_waiting;

static void tell_change(const char *word, const char *value, bool taken)
{
    if (taken) {
        n_taken++;
        log_line(LOG_EVENT, "reload option=%s value=\"%s\"", word, value);
    } else {
        n_waiting++;
        log_line(LOG_WARN, "reload option=%s: the new value \"%s\" needs a restart", word,
                 value);
    }
}

void configuration_reload(struct server *server, int argc, char **argv)
{
    struct options fresh;
    char fault[256], token[TOKEN_ROOM] = "";
    bool failed = options_reread(argc, argv, &fresh, fault) || check_words(&fresh, fault) ||
                  (fresh.token_file[0] && token_read(fresh.token_file, token, fault));
    // Addresses that were bound because a token was set stay bound: it cannot be removed.
    if (!failed && access_has_default(server->access) && !token[0]) {
        failed = true;
        snprintf(fault, sizeof fault, "token-file: removing the token needs a restart");
    }
    if (!failed && !server->tls != !fresh.tls_cert[0]) {
        failed = true;
        snprintf(fault, sizeof fault, "tls-cert: beginning or ending TLS needs a restart");
    }
    if (!failed && server->tls)
        failed = tls_reload(server->tls, fresh.tls_cert, fresh.tls_key, fault);
    if (failed) {
        log_line(LOG_ERR, "reload refused, nothing changed: %s", fault);
        return;
    }
    n_taken = n_waiting = 0;
    if (token[0] && !access_is_default(server->access, token)) {
        access_set_default(server->access, token);
        tell_change("token", "(secret)", true);
    }
    if (server->tls) {
        char certificate[256];
        tls_describe(server->tls, certificate, sizeof certificate);
        log_line(LOG_EVENT, "reload certificate=\"%s\"", certificate);
    }
    options_update(&server->options, &fresh, tell_change);
    ledger_update_quotas(server->ledger);
    log_set_level((enum log_level)log_level_parse(server->options.log));
    server->access_level = log_level_parse(server->options.log_access);
    log_line(LOG_EVENT, "reload done changed=%u needs_restart=%u", n_taken, n_waiting);
}
