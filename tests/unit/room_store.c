// SPDX-License-Identifier: MIT
// The embedded store of rooms: earlier versions are brought up to date, other files are
// refused, tasks that suppose another log conflict, closed rooms go.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "rooms/sqlite_schema.h"
#include "rooms/store.h"

static const char id[] = "0123456789abcdef0123456789abcdef";
static struct loop *loop;
static struct room_store *store;
static char path[] = "/tmp/relight-store-XXXXXX", file[64];

static int setup(void **state)
{
    strcpy(path, "/tmp/relight-store-XXXXXX");
    assert_non_null(mkdtemp(path));
    snprintf(file, sizeof file, "%s/rooms.sqlite", path);
    assert_int_equal(loop_create(&loop), 0);
    return 0;
}

static int teardown(void **state)
{
    static const char *const ends[] = {"", "-wal", "-shm", "-journal"};
    char name[80];
    for (int i = 0; i < 4; i++) {
        snprintf(name, sizeof name, "%s%s", file, ends[i]);
        unlink(name);
    }
    rmdir(path);
    loop_destroy(loop);
    return 0;
}

// In PostgreSQL each case has a database of its own (deploy/cluster/with_postgres).
static bool in_postgres(void)
{
    return getenv("RELIGHT_TEST_POSTGRES") != NULL;
}

static void open_store(void)
{
    char error[256] = "", where[300], command[400];
    const char *server = getenv("RELIGHT_TEST_POSTGRES"), *name = strrchr(path, '/') + 1;
    if (!server) {
        if (room_store_sqlite.open(file, loop, &store, error)) fail_msg("%s", error);
        return;
    }
    snprintf(command, sizeof command, "psql -qc 'CREATE DATABASE \"%s\"' '%s' >/dev/null 2>&1",
             name, server);
    (void)!system(command);
    snprintf(where, sizeof where, "postgresql://relightd@/%s%s", name, strchr(server, '?'));
    if (room_store_postgres.open(where, loop, &store, error)) fail_msg("%s", error);
}

static void refused(const char *word)
{
    char error[256] = "";
    struct room_store *none;
    assert_int_equal(room_store_sqlite.open(file, loop, &none, error), -1);
    if (!strstr(error, word)) fail_msg("\"%s\" does not say %s", error, word);
}

static int n_open;
static void ended(struct room_task *task)
{
    n_open--;
}

static void submit(struct room_task *task)
{
    task->done = ended;
    n_open++;
    store->api->submit(store, task);
}

static void run(struct room_task *task)
{
    submit(task);
    while (n_open) loop_turn(loop, -1);
}

static struct room_task append_task(uint64_t sequence)
{
    static const uint8_t bytes[5] = "event";
    struct room_task t = {
        .kind = ROOM_TASK_APPEND, .sequence = sequence, .time_us = 5, .bytes = bytes, .n = 5};
    strcpy(t.room, id);
    return t;
}

static void sql(const char *text)
{
    sqlite3 *db;
    assert_int_equal(sqlite3_open(file, &db), 0);
    char *why = NULL;
    if (sqlite3_exec(db, text, NULL, NULL, &why)) fail_msg("%s", why);
    sqlite3_close(db);
}

// Statements of version 1 as they were; they stay so when the schema changes.
static const char version_1[] =
    "CREATE TABLE room (number INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE,"
    " sequence INTEGER NOT NULL, created_us INTEGER NOT NULL, changed_us INTEGER NOT NULL);"
    "CREATE TABLE event (room INTEGER NOT NULL, sequence INTEGER NOT NULL, bytes BLOB NOT NULL,"
    " PRIMARY KEY (room, sequence)) WITHOUT ROWID;"
    "CREATE TABLE snapshot (room INTEGER PRIMARY KEY, sequence INTEGER NOT NULL,"
    " bytes BLOB NOT NULL);"
    "INSERT INTO room VALUES (1, '0123456789abcdef0123456789abcdef', 2, 10, 20);"
    "INSERT INTO event VALUES (1, 1, x'6162'), (1, 2, x'636465');"
    "PRAGMA user_version=1; PRAGMA application_id=1380733517;";

static void version_1_is_brought_up_to_date(void **state)
{
    sql(version_1);
    for (int start = 0; start < 2; start++) { // the second finds today's version
        open_store();
        struct room_task load = {.kind = ROOM_TASK_LOAD};
        strcpy(load.room, id);
        run(&load);
        assert_int_equal(load.status, ROOM_TASK_DONE);
        assert_int_equal(load.n_event, 2 + start);
        assert_memory_equal(load.event[1].bytes, "cde", 3);
        assert_int_equal(load.stored_bytes, 5 + start * (5 + ROOM_EVENT_CHARGE));
        room_task_finish(&load);
        struct room_task next = append_task(3 + (uint64_t)start);
        run(&next);
        assert_int_equal(next.status, ROOM_TASK_DONE);
        store->api->close(store);
    }
}

static void a_migration_that_fails_changes_nothing(void **state)
{
    sql(version_1);
    sql("CREATE TABLE member (another INTEGER)"); // in the way of version 2
    refused("version 2");
    sql("DROP TABLE member");
    open_store();
    store->api->close(store);
}

static void other_files_are_refused(void **state)
{
    sql("CREATE TABLE letters (text TEXT)");
    refused("another program's");
    teardown(NULL), setup(NULL);
    sql("CREATE TABLE room (n INTEGER); PRAGMA application_id=1380733517; PRAGMA user_version=99");
    refused("version 99");
    teardown(NULL), setup(NULL);
    FILE *f = fopen(file, "w");
    for (int i = 0; i < 1000; i++) fputs("no database", f);
    fclose(f);
    refused("not a database");
    teardown(NULL), setup(NULL);
    open_store();
    refused("another relightd");
    store->api->close(store);
    snprintf(file, sizeof file, "/proc/nowhere/rooms");
    refused("unable to open");
}

static void a_log_has_no_gaps(void **state)
{
    open_store();
    struct room_task first = append_task(1), again = append_task(1), gap = append_task(3),
                     second = append_task(2), other = append_task(2);
    strcpy(other.room, "fedcba9876543210fedcba9876543210");
    // All wait at once: one transaction has those that fit and those that do not.
    submit(&first), submit(&again), submit(&gap), submit(&second);
    run(&other);
    assert_int_equal(first.status, ROOM_TASK_DONE);
    assert_int_equal(again.status, ROOM_TASK_CONFLICT);
    assert_int_equal(gap.status, ROOM_TASK_CONFLICT);
    assert_int_equal(second.status, ROOM_TASK_DONE);
    assert_int_equal(other.status, ROOM_TASK_MISSING);
    struct room_task events = {.kind = ROOM_TASK_EVENTS, .sequence = 1};
    strcpy(events.room, id);
    run(&events);
    assert_int_equal(events.n_event, 1);
    assert_int_equal(events.event[0].sequence, 2);
    room_task_finish(&events);
    // A snapshot of what is not in the log is not taken.
    struct room_task snapshot = append_task(7);
    snapshot.kind = ROOM_TASK_SNAPSHOT;
    run(&snapshot);
    assert_int_equal(snapshot.status, ROOM_TASK_CONFLICT);
    snapshot.sequence = 2;
    run(&snapshot);
    assert_int_equal(snapshot.status, ROOM_TASK_DONE);
    struct room_task load = {.kind = ROOM_TASK_LOAD};
    strcpy(load.room, id);
    run(&load);
    assert_int_equal(load.sequence, 2);
    assert_int_equal(load.n_event, 0);
    assert_int_equal(load.n_snapshot, 5);
    room_task_finish(&load);
    store->api->close(store);
}

static void lists_and_closed_rooms(void **state)
{
    struct room_member members[] = {{"token:ann", 3}, {"*", 1}};
    struct room_summary summary = {
        .name = "ann's", .owner = "token:ann", .n_member = 2, .member = members};
    open_store();
    struct room_task add = append_task(1);
    add.summary = &summary;
    run(&add);
    static const struct {
        const char *by;
        size_t n;
        int role;
    } cases[] = {{"token:ann", 1, 3}, {"token:bob", 1, 1}, {"", 1, 1}};
    for (int i = 0; i < 3; i++) {
        struct room_task list = {.kind = ROOM_TASK_LIST, .most = 10};
        strcpy(list.by, cases[i].by);
        run(&list);
        assert_int_equal(list.n_row, cases[i].n);
        assert_int_equal(list.row[0].role, cases[i].role);
        assert_string_equal(list.row[0].name, "ann's");
        room_task_finish(&list);
    }
    struct room_task purge = {.kind = ROOM_TASK_PURGE, .time_us = 1000};
    run(&purge);
    assert_int_equal(purge.n_row, 0);
    struct room_task close = append_task(2);
    summary.closed = true;
    close.summary = &summary;
    run(&close);
    purge.time_us = 5; // it was closed then, not before
    run(&purge);
    assert_int_equal(purge.n_row, 0);
    purge.time_us = 6;
    run(&purge);
    assert_int_equal(purge.n_row, 1);
    assert_string_equal(purge.row[0].by, "token:ann");
    assert_int_equal(purge.row[0].bytes, 2 * (5 + ROOM_EVENT_CHARGE));
    room_task_finish(&purge);
    struct room_task load = {.kind = ROOM_TASK_LOAD};
    strcpy(load.room, id);
    run(&load);
    assert_int_equal(load.status, ROOM_TASK_MISSING);
    store->api->close(store);
}

// The room that changed last comes first, and a short list has the newest alone.
static void the_newest_room_comes_first(void **state)
{
    static const char ids[] = "abc";
    struct room_summary summary = {.name = "one", .owner = "token:ann"};
    open_store();
    for (uint64_t i = 0; i < 3; i++) {
        struct room_task add = append_task(1);
        add.room[0] = ids[i];
        add.time_us = 10 + i;
        add.summary = &summary;
        run(&add);
    }
    struct room_task next = append_task(2); // the first one changes again
    next.room[0] = ids[0];
    next.time_us = 20;
    run(&next);
    assert_int_equal(next.status, ROOM_TASK_DONE);
    for (unsigned most = 1; most < 5; most++) {
        struct room_task list = {.kind = ROOM_TASK_LIST, .most = most};
        run(&list);
        assert_int_equal(list.n_row, most < 3 ? most : 3);
        for (size_t i = 0; i < list.n_row; i++) assert_int_equal(list.row[i].room[0], "acb"[i]);
        assert_int_equal(list.row[0].created_us, 10);
        assert_int_equal(list.row[0].changed_us, 20);
        room_task_finish(&list);
    }
    store->api->close(store);
}

// An answer of limited bytes has at least one event, so that every log is read to its end.
static void events_come_in_limited_answers(void **state)
{
    static const struct {
        size_t most, n;
    } cases[] = {{1, 1}, {5, 1}, {9, 1}, {10, 2}, {14, 2}, {20, 4}, {1000, 4}, {0, 4}};
    open_store();
    for (uint64_t i = 1; i < 5; i++) {
        struct room_task add = append_task(i);
        run(&add);
        assert_int_equal(add.status, ROOM_TASK_DONE);
    }
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct room_task events = {.kind = ROOM_TASK_EVENTS, .most = cases[i].most};
        strcpy(events.room, id);
        run(&events);
        assert_int_equal(events.status, ROOM_TASK_DONE);
        assert_int_equal(events.n_event, cases[i].n);
        for (size_t k = 0; k < events.n_event; k++)
            assert_int_equal(events.event[k].sequence, k + 1);
        room_task_finish(&events);
    }
    store->api->close(store);
}

// ---- what rooms need of the disk

static const char needs[] = "\nabc\ndef\n";

// NULL: the store does not know it. Else the text, to free().
static char *needed(size_t n_row)
{
    struct room_task read = {.kind = ROOM_TASK_KEEPS};
    strcpy(read.room, id);
    run(&read);
    assert_int_equal(read.status, ROOM_TASK_DONE);
    assert_int_equal(read.n_row, n_row);
    char *text = n_row && read.row[0].keeps ? strdup(read.row[0].keeps) : NULL;
    room_task_finish(&read);
    return text;
}

static void needs_are(const char *text)
{
    char *there = needed(1);
    assert_non_null(there);
    assert_string_equal(there, text);
    free(there);
}

static void needs_are_written_with_the_event(void **state)
{
    open_store();
    struct room_task add = append_task(1), next = append_task(2), twice = append_task(2);
    run(&add);
    assert_null(needed(1)); // as a room of an earlier version
    struct room_task set = {.kind = ROOM_TASK_SET_KEEPS, .sequence = 1, .keeps = ""};
    strcpy(set.room, id);
    run(&set);
    assert_int_equal(set.status, ROOM_TASK_DONE);
    needs_are("");
    next.keeps = needs;
    run(&next);
    needs_are(needs);
    twice.keeps = "\nother\n"; // refused with its event
    run(&twice);
    assert_int_equal(twice.status, ROOM_TASK_CONFLICT);
    set.keeps = "\nold\n"; // of a state that has grown since
    run(&set);
    assert_int_equal(set.status, ROOM_TASK_CONFLICT);
    needs_are(needs);
    struct room_task all = {.kind = ROOM_TASK_KEEPS};
    run(&all);
    assert_int_equal(all.n_row, 1);
    assert_string_equal(all.row[0].room, id);
    room_task_finish(&all);
    struct room_summary summary = {.name = "ann's", .owner = "token:ann", .closed = true};
    struct room_task close = append_task(3), purge = {.kind = ROOM_TASK_PURGE, .time_us = 6};
    close.summary = &summary;
    run(&close);
    run(&purge);
    assert_int_equal(purge.n_row, 1);
    room_task_finish(&purge);
    assert_null(needed(0));
    store->api->close(store);
}

// ---- several replicas on one database

static struct room_change heard[16];
static int n_heard;
static void hear(void *user, const struct room_change *change)
{
    if (n_heard < 16) heard[n_heard++] = *change;
}

static void psql(const char *sql_text)
{
    char command[600];
    snprintf(command, sizeof command, "psql -qtc \"%s\" '%s' >/dev/null", sql_text,
             getenv("RELIGHT_TEST_POSTGRES"));
    assert_int_equal(system(command), 0);
}

// Waits until n stores have asked the database to be told.
static void wait_for_listeners(int n)
{
    char command[600];
    int got = 0;
    snprintf(
        command, sizeof command,
        "psql -qtAc \"SELECT count(*) FROM pg_stat_activity WHERE query LIKE 'LISTEN%%' AND "
        "state = 'idle' AND datname = '%s'\" '%s'",
        strrchr(path, '/') + 1, getenv("RELIGHT_TEST_POSTGRES"));
    for (int i = 0; i < 300 && got != n; i++) {
        if (i) usleep(50000);
        FILE *answer = popen(command, "r");
        assert_non_null(answer);
        assert_int_equal(fscanf(answer, "%d", &got), 1);
        pclose(answer);
    }
    assert_int_equal(got, n);
}

static void another_replica_hears(void **state)
{
    struct room_summary summary = {.name = "ann's", .owner = "token:ann"};
    open_store();
    struct room_store *mine = store;
    open_store();
    struct room_store *other = store;
    other->changed = hear;
    n_heard = 0;
    wait_for_listeners(2);
    store = mine;
    struct room_task add = append_task(1), next = append_task(2), late = append_task(2);
    add.summary = &summary;
    add.keeps = needs;
    run(&add), run(&next);
    for (int i = 0; i < 100 && n_heard < 2; i++) loop_turn(loop, 20);
    assert_int_equal(n_heard, 2);
    assert_string_equal(heard[0].room, id);
    assert_true(heard[0].summary && !heard[1].summary);
    assert_true(heard[0].keeps && !heard[1].keeps);
    assert_int_equal(heard[1].sequence, 2);
    // A room that is deleted is heard of, too.
    struct room_summary closed = {.name = "gone", .owner = "token:ann", .closed = true};
    struct room_task gone = append_task(1), purge = {.kind = ROOM_TASK_PURGE, .time_us = 6};
    gone.room[0] = 'f';
    gone.summary = &closed;
    run(&gone), run(&purge);
    assert_int_equal(purge.n_row, 1);
    room_task_finish(&purge);
    for (int i = 0; i < 100 && n_heard < 4; i++) loop_turn(loop, 20);
    assert_int_equal(n_heard, 4);
    assert_string_equal(heard[3].room, gone.room);
    assert_true(heard[3].keeps && !heard[3].summary);
    // The other supposes a log that has grown meanwhile.
    store = other;
    static const uint8_t bytes[5] = "other";
    late.bytes = bytes;
    run(&late);
    assert_int_equal(late.status, ROOM_TASK_CONFLICT);
    struct room_task load = {.kind = ROOM_TASK_LOAD};
    strcpy(load.room, id);
    run(&load);
    assert_int_equal(load.n_event, 2);
    room_task_finish(&load);
    mine->api->close(mine);
    other->api->close(other);
}

// Its connections are ended: what was missed meanwhile is told, and no task notices.
static void connections_are_lost(void **state)
{
    char text[400];
    open_store();
    store->changed = hear;
    wait_for_listeners(1);
    struct room_task first = append_task(1), second = append_task(2), third = append_task(3);
    run(&first);
    snprintf(text, sizeof text,
             "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname='%s'",
             strrchr(path, '/') + 1);
    n_heard = 0;
    psql(text);
    run(&second);
    assert_int_equal(second.status, ROOM_TASK_DONE);
    bool all = false;
    for (int i = 0; i < 200 && !all; i++) {
        loop_turn(loop, 20);
        for (int k = 0; k < n_heard; k++) all |= heard[k].all;
    }
    assert_true(all);
    run(&third);
    assert_int_equal(third.status, ROOM_TASK_DONE);
    store->api->close(store);
}

// The server dies: nothing is acknowledged, the reason is told, and it goes on by itself.
static void the_database_is_away(void **state)
{
    open_store();
    struct room_task first = append_task(1), second = append_task(2);
    run(&first);
    assert_int_equal(first.status, ROOM_TASK_DONE);
    int pid = 0;
    FILE *f = fopen(getenv("RELIGHT_TEST_POSTGRES_PID"), "r");
    assert_int_equal(fscanf(f, "%d", &pid), 1);
    fclose(f);
    kill(pid, SIGQUIT);
    for (int i = 0; i < 200 && !store->away; i++) usleep(20000);
    assert_true(store->away);
    run(&second);
    assert_int_equal(second.status, ROOM_TASK_FAILED);
    if (!strstr(second.error, "away")) fail_msg("\"%s\"", second.error);
    for (int i = 0; i < 1500 && store->away; i++) usleep(20000);
    run(&second);
    if (second.status) fail_msg("away %d: \"%s\"", (int)store->away, second.error);
    assert_int_equal(second.status, ROOM_TASK_DONE);
    store->api->close(store);
}

int main(void)
{
    if (in_postgres()) {
        const struct CMUnitTest tests[] = {
            cmocka_unit_test_setup_teardown(a_log_has_no_gaps, setup, teardown),
            cmocka_unit_test_setup_teardown(lists_and_closed_rooms, setup, teardown),
            cmocka_unit_test_setup_teardown(the_newest_room_comes_first, setup, teardown),
            cmocka_unit_test_setup_teardown(events_come_in_limited_answers, setup, teardown),
            cmocka_unit_test_setup_teardown(needs_are_written_with_the_event, setup, teardown),
            cmocka_unit_test_setup_teardown(another_replica_hears, setup, teardown),
            cmocka_unit_test_setup_teardown(connections_are_lost, setup, teardown),
            cmocka_unit_test_setup_teardown(the_database_is_away, setup, teardown),
        };
        return cmocka_run_group_tests(tests, NULL, NULL);
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(version_1_is_brought_up_to_date, setup, teardown),
        cmocka_unit_test_setup_teardown(a_migration_that_fails_changes_nothing, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(other_files_are_refused, setup, teardown),
        cmocka_unit_test_setup_teardown(a_log_has_no_gaps, setup, teardown),
        cmocka_unit_test_setup_teardown(lists_and_closed_rooms, setup, teardown),
        cmocka_unit_test_setup_teardown(the_newest_room_comes_first, setup, teardown),
        cmocka_unit_test_setup_teardown(events_come_in_limited_answers, setup, teardown),
        cmocka_unit_test_setup_teardown(needs_are_written_with_the_event, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
