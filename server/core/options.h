/* SPDX-License-Identifier: MIT */
/* options.h owns what the daemon can be told: one table gives the command line, --help, the
 * configuration file's words and its annotated default. */
#ifndef RELIGHTD_OPTIONS_H
#define RELIGHTD_OPTIONS_H

#include "prt/base.h"

#include <stdbool.h>
#include <stdint.h>

enum { OPTIONS_MAX_LISTEN = 16 };

/* kind, field, word, value's name, default, explanation */
#define OPTIONS_LIST(X)                                                                           \
    X(TEXT, models, "models", "DIR", "",                                                          \
      "Folder whose model files (.glb .gltf .obj .ply) and .prt files are available by name")     \
    X(TEXT, data, "data", "DIR", "",                                                              \
      "Folder for uploads, bakes and the catalogue; survives restarts. Empty: a temporary "       \
      "folder that is removed at the end")                                                        \
    X(TEXT, http, "http", "HOST:PORT", "",                                                        \
      "Serve HTTP and WebSocket here: /healthz /metrics /ws and the page. Empty: no HTTP")        \
    X(TEXT, page, "page", "DIR", "", "Folder of static files that HTTP serves at /")              \
    X(TEXT, origins, "origins", "LIST", "",                                                       \
      "Web origins, comma-separated, that may open the WebSocket beside the page's own; * for "   \
      "all")                                                                                      \
    X(TEXT, hosts, "hosts", "LIST", "",                                                           \
      "Names, comma-separated, under which HTTP is reached, beside loopback names and the "       \
      "address it listens on; a request for another Host is refused; * for all")                  \
    X(TEXT, token_file, "token-file", "FILE", "",                                                 \
      "First line: the token a client must say in HELLO, and a scraper of /metrics as "           \
      "`Authorization: Bearer TOKEN`. Empty: none is wanted")                                     \
    X(FLAG, accept_anyone, "accept-anyone", "yes|no", "no",                                       \
      "Listen beyond loopback without a token file: every machine that reaches the address may "  \
      "use this daemon")                                                                          \
    X(TEXT, socket_mode, "socket-mode", "MODE", "0660",                                           \
      "Permissions of unix sockets, octal: who may write may connect")                            \
    X(TEXT, socket_group, "socket-group", "GROUP", "",                                            \
      "Group of unix sockets. Empty: the daemon's own")                                           \
    X(TEXT, prt, "prt", "PROGRAM", "",                                                            \
      "The prt program that bakes. Empty: the one beside relightd, else on PATH")                 \
    X(TEXT, log, "log", "LEVEL", "event", "error, warning, event or trace")                       \
    X(TEXT, cpu, "cpu", "ISA", "", "Widest instruction set: " PRT_CPU_WORDS ". Empty: detect")    \
    X(COUNT, threads, "threads", "N", "0", "Worker threads. 0: one a core")                       \
    X(COUNT, bakes, "bakes", "N", "1", "Bakes that run at once; others wait their turn")          \
    X(COUNT, bake_queue, "bake-queue", "N", "64", "Bakes that may wait; more are refused")        \
    X(COUNT, bake_threads, "bake-threads", "N", "0", "Threads of one bake. 0: one a core")        \
    X(COUNT, bake_nice, "bake-nice", "N", "5",                                                    \
      "How far a bake steps back for relighting, 0 to 19. On a machine that is busy with other "  \
      "things a large value may starve it")                                                       \
    X(BYTES, bake_memory, "bake-memory", "BYTES", "0",                                            \
      "Memory of one bake; one that needs more fails. 0: as its settings are estimated to need")  \
    X(SECONDS, bake_time, "bake-time", "SECONDS", "21600",                                        \
      "Longest a bake may run; then it is stopped. 0: no limit")                                  \
    X(BYTES, memory, "memory", "BYTES", "8G",                                                     \
      "Baked transport held ready; beyond it the least recently used model is unloaded")          \
    X(BYTES, cache, "cache", "BYTES", "1G",                                                       \
      "Decoded environments, lights, visibility buffers and colours kept for reuse")              \
    X(BYTES, disk, "disk", "BYTES", "64G", "Uploads and bakes kept under --data in all")          \
    X(BYTES, bakes_disk, "bakes-disk", "BYTES", "32G",                                            \
      "Bakes kept under --data; beyond it the longest unused one that is not pinned is deleted, " \
      "and baked anew when it is loaded again")                                                   \
    X(BYTES, max_blob, "max-blob", "BYTES", "1G", "Largest upload")                               \
    X(BYTES, decode_memory, "decode-memory", "BYTES", "4G",                                       \
      "Memory a process that decodes an untrusted image may take")                                \
    X(BYTES, decode_total, "decode-total", "BYTES", "0",                                          \
      "Memory that processes which decode may take together: more wait their turn. 0: half of "   \
      "the machine's")                                                                            \
    X(FLAG, accept_weak_sandbox, "accept-weak-sandbox", "yes|no", "no",                           \
      "Decode files even where the system cannot confine the process that does so (no seccomp, "  \
      "no Landlock)")                                                                             \
    X(COUNT, connections, "connections", "N", "1100",                                             \
      "Connections at once, over all carriers")                                                   \
    X(COUNT, client_connections, "client-connections", "N", "0",                                  \
      "Connections of one client (token, local user or address). 0: no limit of its own")         \
    X(COUNT, requests, "requests", "N", "256",                                                    \
      "Requests one connection may have open; more are answered busy")                            \
    X(COUNT, client_requests, "client-requests", "N", "2048",                                     \
      "Requests one client may have open over all its connections")                               \
    X(COUNT, queue, "queue", "N", "4096", "Requests open in all; more are answered busy")         \
    X(COUNT, client_views, "client-views", "N", "512",                                            \
      "Views and watches one client may have open; they do not count as requests")                \
    X(COUNT, views, "views", "N", "4096", "Views and watches open in all")                        \
    X(BYTES, client_memory, "client-memory", "BYTES", "512M",                                     \
      "Bytes that one client's requests and views may hold: payloads, lights, vertices")          \
    X(BYTES, request_memory, "request-memory", "BYTES", "2G",                                     \
      "Bytes that all requests and views may hold")                                               \
    X(BYTES, client_output, "client-output", "BYTES", "512M",                                     \
      "Bytes of answers that one client has not read yet")                                        \
    X(BYTES, output_memory, "output-memory", "BYTES", "2G",                                       \
      "Bytes of answers not read yet, of all clients")                                            \
    X(COUNT, client_jobs, "client-jobs", "N", "32",                                               \
      "Bakes one client may have waiting or running")                                             \
    X(COUNT, client_uploads, "client-uploads", "N", "16",                                         \
      "Uploads one client may have under way")                                                    \
    X(COUNT, uploads, "uploads", "N", "256", "Uploads under way in all")                          \
    X(COUNT, client_models, "client-models", "N", "1000",                                         \
      "Models one client may have loaded, previews counted")                                      \
    X(COUNT, max_models, "max-models", "N", "10000", "Models known at once")                      \
    X(BYTES, client_disk, "client-disk", "BYTES", "16G",                                          \
      "Uploads, previews and bakes of one client kept under --data")                              \
    X(SECONDS, handshake, "handshake", "SECONDS", "5",                                            \
      "Close a connection that has not sent HELLO so long after it was accepted")                 \
    X(SECONDS, write_time, "write-time", "SECONDS", "10",                                         \
      "Close a connection that reads nothing for so long while an answer waits for it")           \
    X(BYTES, send_buffer, "send-buffer", "BYTES", "64M",                                          \
      "Answers waiting for one slow reader before its requests are no longer read; at four "      \
      "times that it is disconnected")                                                            \
    X(SECONDS, idle, "idle", "SECONDS", "600", "Close a connection that says nothing so long")    \
    X(SECONDS, frame_time, "frame-time", "SECONDS", "30",                                         \
      "Close a connection that has begun a frame and does not finish it")                         \
    X(SECONDS, deadline, "deadline", "SECONDS", "120",                                            \
      "Longest a request may take; clients may ask for less")                                     \
    X(SECONDS, drain, "drain", "SECONDS", "10",                                                   \
      "After SIGTERM, how long open requests get before the daemon leaves anyway")                \
    X(COUNT, max_side, "max-side", "PIXELS", "4096", "Largest width and height of an image")

struct options {
#define OPTION_FIELD_TEXT(f) const char *f;
#define OPTION_FIELD_COUNT(f) uint32_t f;
#define OPTION_FIELD_BYTES(f) uint64_t f;
#define OPTION_FIELD_SECONDS(f) double f;
#define OPTION_FIELD_FLAG(f) bool f;
#define X(kind, field, word, value, preset, text) OPTION_FIELD_##kind(field)
    OPTIONS_LIST(X)
#undef X
    const char *listen[OPTIONS_MAX_LISTEN]; /* tcp:HOST:PORT or unix:PATH */
    unsigned n_listen;
    bool check; /* --check: say whether the configuration is fine, and leave */
};

/* Fills *options from defaults, then the configuration file, then the command line. Prints and
 * exits 2 on wrong usage, exits 0 after --help, --version and --print-config. */
void options_parse(int argc, char **argv, struct options *options);
/* Sets what the lines of a configuration say; options then point into `text`, which is cut at
 * its ends of words. Returns 0, or -1 with the first fault and its line (errors call the text
 * `name`). */
int options_read_config(struct options *options, const char *name, char *text, char error[300]);

/* Reads the same configuration file and command line again, into *options. 0, or -1 with the
 * fault's words; prints nothing. Texts of earlier readings stay valid. */
int options_reread(int argc, char **argv, struct options *options, char fault[256]);
/* Calls tell for each option whose value in `fresh` differs from the one in `options`: taken,
 * where it may change while the daemon runs and is copied; else it waits for a restart. */
void options_update(struct options *options, const struct options *fresh,
                    void (*tell)(const char *word, const char *value, bool taken));

#endif
