/* SPDX-License-Identifier: MIT */
/* options.h owns the daemon's options: one table for the command line, --help, the
 * configuration file and its annotated default. */
#ifndef RELIGHTD_OPTIONS_H
#define RELIGHTD_OPTIONS_H

#include "prt/base.h"

#include <stdbool.h>
#include <stdint.h>

enum { OPTIONS_MAX_LISTEN = 16 };

/* kind, field, option name, name of the value, default, explanation */
#define OPTIONS_LIST(X)                                                                         \
    X(TEXT, models, "models", "DIR", "",                                                        \
      "Folder whose model files (.glb .gltf .obj .ply .stl) and .prt files are available "      \
      "by name; what its folders NAME/VERSION hold is loaded without being asked for")          \
    X(SECONDS, poll, "poll", "S", "2",                                                          \
      "Between two looks at --models for new, replaced and removed models. 0: only at the "     \
      "start, and when the system reports a change in the folder itself")                       \
    X(TEXT, data, "data", "DIR", "",                                                            \
      "Folder for uploads, bakes and the catalogue; survives restarts. Empty: a "               \
      "temporary folder that is removed at the end")                                            \
    X(TEXT, store, "store", "DIR", "",                                                          \
      "Folder that several relightd share, on a file system that all of them mount: uploads, "  \
      "bakes and the records of models; --data stays private to each. Empty: one machine")      \
    X(SECONDS, store_poll, "store-poll", "SECONDS", "2",                                        \
      "Between two looks at --store for models of others")                                      \
    X(SECONDS, store_keep, "store-keep", "SECONDS", "0",                                        \
      "Remove an upload of --store, and a bake of no model, that nobody used for this time, "   \
      "and no review room needs; at least a day. 0: never")                                     \
    X(TEXT, http, "http", "HOST:PORT", "",                                                      \
      "Serve HTTP and WebSocket here: the API at /v1, /healthz, /readyz, /metrics, /ws "        \
      "and the page. Empty: no HTTP")                                                           \
    X(TEXT, page, "page", "DIR", "",                                                            \
      "Folder of the page, static files that HTTP serves at /. Empty: share/relight/page "      \
      "beside the folder of this program")                                                      \
    X(TEXT, origins, "origins", "LIST", "",                                                     \
      "Web origins, comma-separated, that may open the WebSocket and read answers of the "      \
      "API besides the page's own, such as https://shop.example for a shop that embeds "        \
      "the viewer; * for all. Signed links to pictures need none")                              \
    X(TEXT, hosts, "hosts", "LIST", "",                                                         \
      "Host names, comma-separated, that HTTP requests may name besides loopback "              \
      "names and the address it listens on; requests for other hosts are refused; * "           \
      "for all")                                                                                \
    X(TEXT, replicas, "replicas", "LIST", "",                                                   \
      "Addresses of all replicas, comma-separated, as their clients reach them (tcp:HOST:"      \
      "PORT): a client that names its model in HELLO is sent to the replica that serves it. "   \
      "Where a proxy chooses the replica this stays empty")                                     \
    X(TEXT, advertise, "advertise", "ADDRESS", "",                                              \
      "This daemon's own address among --replicas")                                             \
    X(TEXT, proxies, "proxies", "LIST", "",                                                     \
      "Addresses and prefixes of proxies, comma-separated, such as 10.0.0.0/8,::1. What "       \
      "comes from there begins with a PROXY header, version 2, which names the client: TCP, "   \
      "HTTP and WebSocket. Others must not send one")                                           \
    X(TEXT, token_file, "token-file", "FILE", "",                                               \
      "File whose first line is a token with every scope, named `default`. Further "            \
      "tokens are made with `relight token create`. Clients of TCP, HTTP and WebSocket "        \
      "need one of them as soon as one exists")                                                 \
    X(TEXT, tls_cert, "tls-cert", "FILE", "",                                                   \
      "Certificate of this daemon, PEM, followed by those that sign it. With it every "         \
      "TCP and HTTP address speaks TLS 1.2 or 1.3 alone; unix sockets do not. SIGHUP "          \
      "reads it again, without closing connections. Empty: no TLS")                             \
    X(TEXT, tls_key, "tls-key", "FILE", "",                                                     \
      "Private key of --tls-cert, PEM, without a password")                                     \
    X(FLAG, tls_loopback, "tls-loopback", "yes|no", "yes",                                      \
      "With --tls-cert: speak TLS on addresses of loopback, too. No: plain text there, "        \
      "for probes and proxies on this machine")                                                 \
    X(FLAG, accept_anyone, "accept-anyone", "yes|no", "no",                                     \
      "Listen beyond loopback without a token: every machine that reaches the address "         \
      "may use this daemon, except for administration")                                         \
    X(TEXT, local_scopes, "local-scopes", "LIST", "view,edit,upload",                           \
      "Scopes of other users of this machine who connect to a unix socket without a token: "    \
      "view, edit, upload, admin, comma-separated. Empty: they need a token. The daemon's "     \
      "own user and root have all")                                                             \
    X(TEXT, socket_mode, "socket-mode", "MODE", "0660",                                         \
      "Permissions of unix sockets, octal: users with write permission may connect")            \
    X(TEXT, socket_group, "socket-group", "GROUP", "",                                          \
      "Group of unix sockets. Empty: the daemon's own")                                         \
    X(TEXT, prt, "prt", "PROGRAM", "",                                                          \
      "The prt program that runs bakes. Empty: the one next to relightd, else the one "         \
      "on PATH")                                                                                \
    X(TEXT, log, "log", "LEVEL", "event", "Log level: error, warning, event or trace")          \
    X(TEXT, log_format, "log-format", "FORMAT", "text",                                         \
      "Format of log lines: text, logfmt (key=value throughout) or json (one object a "         \
      "line)")                                                                                  \
    X(TEXT, log_access, "log-access", "LEVEL", "trace",                                         \
      "Log level of the line about each answered request: event or trace")                      \
    X(TEXT, cpu, "cpu", "ISA", "", "Widest instruction set: " PRT_CPU_WORDS ". Empty: detect")  \
    X(COUNT, threads, "threads", "N", "0", "Worker threads. 0: one for each core")              \
    X(TEXT, runner, "runner", "local|slurm", "local",                                           \
      "Where bakes run: as child processes, or as arrays of Slurm tasks on machines that "      \
      "have prt and mount the folder of --slurm-folder")                                        \
    X(TEXT, slurm_folder, "slurm-folder", "DIR", "",                                            \
      "Folder for the files of bakes on Slurm, such as one under --store. Empty: --data, "      \
      "which the nodes then mount")                                                             \
    X(COUNT, slurm_tasks, "slurm-tasks", "N", "0",                                              \
      "Tasks of one bake on Slurm. 0: one for each node of the partition")                      \
    X(TEXT, slurm_arguments, "slurm-arguments", "TEXT", "",                                     \
      "Further arguments of sbatch, such as --partition=bake --account=studio")                 \
    X(COUNT, bakes, "bakes", "N", "1", "Bakes that run at once; others wait in a queue")        \
    X(COUNT, bake_queue, "bake-queue", "N", "64", "Bakes that wait or run; more are refused")   \
    X(COUNT, bake_threads, "bake-threads", "N", "0",                                            \
      "Threads of one bake. 0: one for each core")                                              \
    X(COUNT, bake_nice, "bake-nice", "N", "5",                                                  \
      "Niceness of bakes, 0 to 19: a larger value leaves relighting more CPU time. On "         \
      "a machine with other load a large value may starve bakes")                               \
    X(BYTES, bake_memory, "bake-memory", "BYTES", "0",                                          \
      "Memory limit of one bake; a bake that needs more fails. 0: the estimate from "           \
      "its settings")                                                                           \
    X(BYTES, bake_checkpoint, "bake-checkpoint", "BYTES", "8G",                                 \
      "Disk space for the finished work of one bake, from which it goes on after a restart "    \
      "of the daemon; it counts as --disk. 0: an interrupted bake starts again")                \
    X(BYTES, bake_cache, "bake-cache", "BYTES", "2G",                                           \
      "Disk space for results of rays under --data, from which a bake of the same model with "  \
      "another material or scale, or of one that was changed in parts, goes on; it does not "   \
      "count as --disk. 0: none are kept")                                                      \
    X(SECONDS, bake_time, "bake-time", "SECONDS", "21600",                                      \
      "Time limit of one bake; the daemon then stops it. 0: no limit")                          \
    X(BYTES, memory, "memory", "BYTES", "8G",                                                   \
      "Memory for open baked transport, in use and pinned models included; beyond it the "      \
      "least recently used model is unloaded, first one of a client whose models take more "    \
      "than an equal share, and others wait for one in use. A model above it is open alone. "   \
      "Pages of unloaded ones, at most a quarter of it and 64M, are kept for the next up to a " \
      "minute longer. Where half of it is free, models that many lights are asked of take "     \
      "three quarters more, and answer faster")                                                 \
    X(BYTES, cache, "cache", "BYTES", "1G",                                                     \
      "Memory for decoded environments, lights, visibility buffers and colours that "           \
      "are kept for reuse")                                                                     \
    X(BYTES, disk, "disk", "BYTES", "64G",                                                      \
      "Disk space for all uploads and bakes under --data, 0: no limit. What rooms need is not " \
      "removed to make room. An upload that puts its principal above an equal share "           \
      "removes no other's files that are within theirs")                                        \
    X(BYTES, bakes_disk, "bakes-disk", "BYTES", "32G",                                          \
      "Disk space for bakes under --data; beyond it the least recently used bake that "         \
      "is not pinned is deleted, and baked again when its model is loaded")                     \
    X(BYTES, max_blob, "max-blob", "BYTES", "1G", "Largest upload")                             \
    X(BYTES, decode_memory, "decode-memory", "BYTES", "4G",                                     \
      "Memory limit of a process that decodes an untrusted image")                              \
    X(BYTES, decode_total, "decode-total", "BYTES", "0",                                        \
      "Memory limit of all decoding processes together; further ones wait. 0: half of "         \
      "the machine's memory")                                                                   \
    X(FLAG, accept_weak_sandbox, "accept-weak-sandbox", "yes|no", "no",                         \
      "Decode files even if the system cannot confine the decoding process (no "                \
      "seccomp, no Landlock)")                                                                  \
    X(COUNT, connections, "connections", "N", "1100", "Open connections, over all carriers")    \
    X(COUNT, client_connections, "client-connections", "N", "0",                                \
      "Open connections of one client (token, local user or address). 0: no separate "          \
      "limit")                                                                                  \
    X(COUNT, requests, "requests", "N", "256",                                                  \
      "Open requests of one connection; more are refused as busy")                              \
    X(COUNT, client_requests, "client-requests", "N", "2048",                                   \
      "Open requests of one client over all its connections")                                   \
    X(COUNT, queue, "queue", "N", "4096",                                                       \
      "Open requests of all clients; more are refused as busy")                                 \
    X(COUNT, client_views, "client-views", "N", "512",                                          \
      "Open views and watches of one client; they do not count as requests")                    \
    X(COUNT, views, "views", "N", "4096", "Open views and watches of all clients")              \
    X(BYTES, client_memory, "client-memory", "BYTES", "512M",                                   \
      "Memory held by one client's requests and views: payloads, lights, vertices")             \
    X(BYTES, request_memory, "request-memory", "BYTES", "2G",                                   \
      "Memory held by all requests and views")                                                  \
    X(BYTES, client_poses, "client-poses", "BYTES", "256M",                                     \
      "Memory of one client's named poses; beyond it the least recently used one goes")         \
    X(BYTES, poses, "poses", "BYTES", "1G", "Memory of all named poses")                        \
    X(BYTES, client_output, "client-output", "BYTES", "512M",                                   \
      "Bytes of answers that one client has not read yet")                                      \
    X(BYTES, output_memory, "output-memory", "BYTES", "2G",                                     \
      "Bytes of answers that all clients have not read yet")                                    \
    X(COUNT, client_jobs, "client-jobs", "N", "32", "Queued and running bakes of one client")   \
    X(COUNT, client_uploads, "client-uploads", "N", "16", "Unfinished uploads of one client")   \
    X(COUNT, uploads, "uploads", "N", "256", "Unfinished uploads of all clients")               \
    X(COUNT, client_models, "client-models", "N", "1000",                                       \
      "Loaded models of one client, previews included")                                         \
    X(COUNT, max_models, "max-models", "N", "10000", "Models that the daemon knows at once")    \
    X(BYTES, client_disk, "client-disk", "BYTES", "16G",                                        \
      "Disk space for one client's uploads, previews and bakes under --data")                   \
    X(FLAG, preview_walks, "preview-walks", "yes|no", "yes",                                    \
      "Scale pictures without a bake to the light that random walks return under even light, "  \
      "from when those are there: some 10 s of one core, in the background, for a model and "   \
      "medium. no: the dipole, too bright in thin parts")                                       \
    X(TEXT, rooms, "rooms", "STORE", "",                                                        \
      "Where review rooms are kept: sqlite:FILE, or postgresql://[USER[:PASSWORD]@]HOST/"       \
      "DATABASE for several relightd. Empty: rooms.sqlite under --data")                        \
    X(TEXT, copy_rooms, "copy-rooms", "STORE", "",                                              \
      "Copy all review rooms from this store into the one of --rooms, compare both, and exit: " \
      "from sqlite:FILE to postgresql://…, or back")                                            \
    X(COUNT, client_rooms, "client-rooms", "N", "1000", "Review rooms that one client made")    \
    X(COUNT, max_rooms, "max-rooms", "N", "100000", "Review rooms of all clients")              \
    X(BYTES, client_room_memory, "client-room-memory", "BYTES", "128M",                         \
      "Memory of the review rooms that one client made and somebody uses; unused ones leave "   \
      "memory first. Beyond it a room is not opened, and takes nothing more")                   \
    X(BYTES, room_memory, "room-memory", "BYTES", "1G", "Memory of all review rooms in use")    \
    X(TEXT, room_hook, "room-hook", "URL", "",                                                  \
      "Post pins and decisions of review rooms here, as JSON: https://HOST[:PORT][/PATH]. "     \
      "The server's certificate is checked against the system's store, or SSL_CERT_FILE")       \
    X(TEXT, room_hook_key, "room-hook-key", "FILE", "",                                         \
      "File whose first line is the key of X-Relight-Signature, the HMAC-SHA256 of what is "    \
      "posted")                                                                                 \
    X(SECONDS, rooms_keep, "rooms-keep", "SECONDS", "2592000",                                  \
      "Delete a review room as long after it was closed. 0: never. Until then the disk keeps "  \
      "the uploads and models that its pins, decisions and revisions need")                     \
    X(SECONDS, room_idle, "room-idle", "SECONDS", "60",                                         \
      "Keep a review room in memory as long after its last use")                                \
    X(SECONDS, handshake, "handshake", "SECONDS", "5",                                          \
      "Close a connection that has not sent HELLO within this time")                            \
    X(SECONDS, write_time, "write-time", "SECONDS", "10",                                       \
      "Close a connection that reads nothing for this time while an answer is waiting")         \
    X(BYTES, send_buffer, "send-buffer", "BYTES", "64M",                                        \
      "Unread answers of one connection above which the daemon stops reading its "              \
      "requests; at four times that it is closed")                                              \
    X(SECONDS, idle, "idle", "SECONDS", "600",                                                  \
      "Close a connection that sends nothing for this time")                                    \
    X(SECONDS, frame_time, "frame-time", "SECONDS", "30",                                       \
      "Close a connection that does not finish a frame within this time")                       \
    X(SECONDS, deadline, "deadline", "SECONDS", "120",                                          \
      "Time limit of a request; clients may set a shorter one")                                 \
    X(SECONDS, lame_duck, "lame-duck", "SECONDS", "0",                                          \
      "Time after SIGTERM in which the daemon still accepts clients and requests, while "       \
      "/readyz fails and clients are told to leave; then it drains. Longer than the "           \
      "health checks of a proxy")                                                               \
    X(SECONDS, drain, "drain", "SECONDS", "10",                                                 \
      "Time that open requests have after SIGTERM and --lame-duck before the daemon exits")     \
    X(TEXT, goaway_address, "goaway-address", "ADDRESS", "",                                    \
      "Address that clients are told to connect to while the daemon stops "                     \
      "(tcp:HOST:PORT). Empty: this one, after the restart")                                    \
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
    bool check; /* --check: report whether the configuration is valid, and exit */
};

/* Fills *options from defaults, then the configuration file, then the command line. Prints and
 * exits 2 on wrong usage, exits 0 after --help, --version and --print-config. */
void options_parse(int argc, char **argv, struct options *options);
/* Sets the options in a configuration's lines. They point into `text` afterwards, which gets
 * zero bytes between words. Returns 0, or -1 with the first error and its line; errors call the
 * text `name`. */
int options_read_config(struct options *options, const char *name, char *text, char error[300]);

/* Reads the same configuration file and command line again, into *options. 0, or -1 with the
 * error's text; prints nothing. Texts of earlier readings stay valid. */
int options_reread(int argc, char **argv, struct options *options, char fault[256]);
/* Calls report for each option whose value in `fresh` differs from the one in `options`. taken:
 * it may change while the daemon runs and was copied; otherwise it needs a restart. */
void options_update(struct options *options, const struct options *fresh,
                    void (*report)(const char *word, const char *value, bool taken));

#endif
