// SPDX-License-Identifier: MIT
#include "usb_mock.h"

#include <errno.h>
#include <linux/usbdevice_fs.h>
#include <sys/ioctl.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <umockdev.h>
#include <unistd.h>

enum { MOST_URBS = 8, MOST_SCRIPT = 4096, MOST_DEVICES = 32, CONFIG_SIZE = 34 };

struct urb {
    UMockdevIoctlData *data, *buffer; // data: NULL: free
    bool done;
};
struct script {
    int error; // 0: a report
    uint8_t bytes[1100];
    size_t n;
};
struct mock_device {
    struct mock_design design;
    UMockdevIoctlBase *base;
    char node[32], path[64];
    bool gone, driver;
    struct urb urb[MOST_URBS];
    UMockdevIoctlClient *reaper; // a REAPURB that waits
    UMockdevIoctlData *reaper_data;
    uint64_t reaper_end;
    struct script *script;
    size_t n_script, at_script;
    struct mock_counts counts;
};

static UMockdevTestbed *testbed;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t wake;
static pthread_t ticker;
static bool stopping;
static int hold_ms, n_device, number;
static struct mock_device *devices[MOST_DEVICES];

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

void mock_preload(char **argv)
{
    const char *loaded = getenv("LD_PRELOAD");
    if (loaded && strstr(loaded, "libumockdev-preload")) return;
    setenv("LD_PRELOAD", CONTROL_PRELOAD, 1);
    execv("/proc/self/exe", argv);
    perror("execv");
    exit(1);
}

// ---- transfers; the lock is held

static struct usbdevfs_urb *urb_of(const struct urb *u)
{
    return (struct usbdevfs_urb *)(void *)u->data->data;
}

static void finish_urb(struct urb *u, int status, const void *bytes, size_t n)
{
    struct usbdevfs_urb *urb = urb_of(u);
    size_t room = (size_t)urb->buffer_length;
    if (n > room) {
        n = room;
        status = -EOVERFLOW;
    }
    if (n) memcpy(u->buffer->data, bytes, n);
    urb->actual_length = (int)n;
    urb->status = status;
    u->done = true;
}

// Gives a waiting REAPURB a transfer that is done, or the end of the device.
static void serve_reaper(struct mock_device *d)
{
    if (!d->reaper) return;
    UMockdevIoctlClient *client = d->reaper;
    struct urb *u = NULL;
    for (int i = 0; i < MOST_URBS && !u; i++)
        if (d->urb[i].data && d->urb[i].done) u = &d->urb[i];
    if (!u && !d->gone && now_ns() < d->reaper_end) return;
    d->reaper = NULL;
    if (!u) {
        umockdev_ioctl_client_complete(client, -1, d->gone ? ENODEV : EAGAIN);
    } else {
        GError *error = NULL;
        umockdev_ioctl_data_set_ptr(d->reaper_data, 0, u->data);
        if (urb_of(u)->type == USBDEVFS_URB_TYPE_INTERRUPT && !urb_of(u)->status) {
            d->counts.n_report++;
            d->counts.delivered_ns = now_ns();
        }
        umockdev_ioctl_client_complete(client, 0, 0);
        g_clear_error(&error);
        g_clear_object(&u->data);
        g_clear_object(&u->buffer);
        u->done = false;
    }
    g_clear_object(&d->reaper_data);
    g_object_unref(client);
}

static void run_script(struct mock_device *d)
{
    for (int i = 0; i < MOST_URBS && d->at_script < d->n_script; i++) {
        struct urb *u = &d->urb[i];
        if (!u->data || u->done || urb_of(u)->type != USBDEVFS_URB_TYPE_INTERRUPT) continue;
        const struct script *s = &d->script[d->at_script++];
        finish_urb(u, s->error, s->bytes, s->n);
    }
    serve_reaper(d);
}

static void control_urb(struct mock_device *d, struct urb *u)
{
    const uint8_t *setup = u->buffer->data;
    uint16_t value = (uint16_t)(setup[2] | setup[3] << 8), index = setup[4],
             length = (uint16_t)(setup[6] | setup[7] << 8);
    if (setup[0] == 0x81 && setup[1] == 6 && value >> 8 == 0x22) { // the report descriptor
        size_t n = d->design.report_size < length ? d->design.report_size : length;
        memcpy(u->buffer->data + 8, d->design.report, n);
        urb_of(u)->actual_length = (int)n;
    } else if (setup[0] == 0x21 && setup[1] == 9) { // SET_REPORT, its id first
        d->counts.led = length ? u->buffer->data[8 + length - 1] : -1;
        urb_of(u)->actual_length = length;
    } else if (setup[0] == 0x41 && setup[1] == 1) { // the PowerMate's brightness
        d->counts.led = index;
    } else {
        urb_of(u)->status = -EPIPE;
    }
    u->done = true;
}

static int submit(struct mock_device *d, UMockdevIoctlData *arg)
{
    struct urb *u = NULL;
    for (int i = 0; i < MOST_URBS && !u; i++)
        if (!d->urb[i].data) u = &d->urb[i];
    if (d->gone) return ENODEV;
    if (!u) return ENOMEM;
    u->data = umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_urb), NULL);
    u->buffer = umockdev_ioctl_data_resolve(u->data, offsetof(struct usbdevfs_urb, buffer),
                                            (gsize)urb_of(u)->buffer_length, NULL);
    u->done = false;
    if (urb_of(u)->type == USBDEVFS_URB_TYPE_CONTROL) control_urb(d, u);
    return 0;
}

static int discard(struct mock_device *d, UMockdevIoctlData *arg)
{
    UMockdevIoctlData *data =
        umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_urb), NULL);
    int error = EINVAL;
    for (int i = 0; i < MOST_URBS; i++) {
        struct urb *u = &d->urb[i];
        if (!u->data || u->done || u->data->client_addr != data->client_addr) continue;
        finish_urb(u, -ENOENT, NULL, 0);
        error = 0;
    }
    g_object_unref(data);
    return error;
}

// ---- ioctls; the lock is held

static int driver_ioctl(struct mock_device *d, UMockdevIoctlData *arg)
{
    UMockdevIoctlData *data =
        umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_ioctl), NULL);
    int code = ((struct usbdevfs_ioctl *)(void *)data->data)->ioctl_code;
    g_object_unref(data);
    if (d->gone) return ENODEV;
    if (code == (int)USBDEVFS_DISCONNECT) {
        if (!d->driver) return ENODATA;
        d->driver = false;
        d->counts.detached++;
        return 0;
    }
    if (code != (int)USBDEVFS_CONNECT) return ENOTTY;
    if (d->driver) return EBUSY;
    d->driver = true;
    d->counts.attached++;
    return 0;
}

static int get_driver(struct mock_device *d, UMockdevIoctlData *arg)
{
    UMockdevIoctlData *data =
        umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_getdriver), NULL);
    strcpy(((struct usbdevfs_getdriver *)(void *)data->data)->driver, "usbhid");
    g_object_unref(data);
    return d->driver ? 0 : ENODATA;
}

static int capabilities(UMockdevIoctlData *arg)
{
    UMockdevIoctlData *data = umockdev_ioctl_data_resolve(arg, 0, 4, NULL);
    *(uint32_t *)(void *)data->data = 0;
    g_object_unref(data);
    return 0;
}

static int claim(struct mock_device *d)
{
    if (d->gone) return ENODEV;
    if (d->design.busy || d->driver) return EBUSY;
    d->counts.claimed++;
    return 0;
}

// An errno, or -1: the client waits.
static int answer(struct mock_device *d, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    unsigned long request = umockdev_ioctl_client_get_request(client);
    switch (request) {
    case USBDEVFS_GET_CAPABILITIES:
        d->counts.open++;
        return capabilities(arg);
    case USBDEVFS_GETDRIVER:
        return get_driver(d, arg);
    case USBDEVFS_IOCTL:
        return driver_ioctl(d, arg);
    case USBDEVFS_CLAIMINTERFACE:
        return claim(d);
    case USBDEVFS_RELEASEINTERFACE:
        d->counts.released++;
        return 0;
    case USBDEVFS_CLEAR_HALT:
        d->counts.clear_halt++;
        return d->gone ? ENODEV : 0;
    case USBDEVFS_SUBMITURB:
        return submit(d, arg);
    case USBDEVFS_DISCARDURB:
        return discard(d, arg);
    case USBDEVFS_REAPURB:
    case USBDEVFS_REAPURBNDELAY:
        d->counts.reaps++;
        d->reaper = g_object_ref(client);
        d->reaper_data = umockdev_ioctl_data_resolve(arg, 0, sizeof(void *), NULL);
        d->reaper_end = now_ns() + (uint64_t)hold_ms * 1000000u;
        return -1;
    default:
        fprintf(stderr, "usb_mock: ioctl %lx\n", request);
        return ENOTTY;
    }
}

static gboolean handle(UMockdevIoctlBase *base, UMockdevIoctlClient *client, gpointer user)
{
    struct mock_device *d = user;
    UMockdevIoctlData *arg = umockdev_ioctl_client_get_arg(client);
    (void)base;
    pthread_mutex_lock(&lock);
    int error = answer(d, client, arg);
    if (error >= 0) umockdev_ioctl_client_complete(client, error ? -1 : 0, error);
    run_script(d);
    pthread_cond_signal(&wake);
    pthread_mutex_unlock(&lock);
    return TRUE;
}

// Ends what waits for its time.
static void *tick(void *unused)
{
    pthread_mutex_lock(&lock);
    while (!stopping) {
        uint64_t at = now_ns() + 1000000000u;
        for (int i = 0; i < n_device; i++) {
            serve_reaper(devices[i]);
            if (devices[i]->reaper && devices[i]->reaper_end < at) at = devices[i]->reaper_end;
        }
        struct timespec t = {(time_t)(at / 1000000000u), (long)(at % 1000000000u)};
        pthread_cond_timedwait(&wake, &lock, &t);
    }
    pthread_mutex_unlock(&lock);
    return unused;
}

// ---- the bus

static void add_hex(char *out, const uint8_t *bytes, size_t n)
{
    for (size_t i = 0; i < n; i++) sprintf(out + 2 * i, "%02X", bytes[i]);
}

void mock_begin(int hold)
{
    static const uint8_t hub[43] = {18, 1, 0, 2, 9, 0,  0, 64, 0x6b, 0x1d, 2,    0, 0, 5, 0,
                                    0,  0, 1, 9, 2, 25, 0, 1,  1,    0,    0xe0, 0, 9, 4, 0,
                                    0,  1, 9, 0, 0, 0,  7, 5,  0x81, 3,    4,    0, 12};
    char text[512], hex[2 * sizeof hub + 1];
    pthread_condattr_t attr;
    pthread_condattr_init(&attr);
    pthread_condattr_setclock(&attr, CLOCK_MONOTONIC);
    pthread_cond_init(&wake, &attr);
    signal(SIGPIPE, SIG_IGN); // a program that dies in an ioctl
    hold_ms = hold;
    n_device = 0;
    number = 1;
    stopping = false;
    testbed = umockdev_testbed_new();
    add_hex(hex, hub, sizeof hub);
    snprintf(text, sizeof text,
             "P: /devices/usb1\nN: bus/usb/001/001\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n"
             "A: busnum=1\\n\nA: devnum=1\\n\nA: bConfigurationValue=1\\n\nA: speed=480\\n\n"
             "H: descriptors=%s\n",
             hex);
    GError *error = NULL;
    if (!umockdev_testbed_add_from_string(testbed, text, &error)) {
        fprintf(stderr, "usb_mock: %s\n", error->message);
        abort();
    }
    pthread_create(&ticker, NULL, tick, NULL);
}

static size_t descriptors(const struct mock_design *m, uint8_t out[18 + CONFIG_SIZE])
{
    uint16_t said = m->said_size ? m->said_size : m->report_size;
    const uint8_t all[18 + CONFIG_SIZE] = {
        18, 1, 0, 2, 0, 0, 0, 8, (uint8_t)m->vendor, (uint8_t)(m->vendor >> 8),
        (uint8_t)m->product, (uint8_t)(m->product >> 8), 0, 1, 0, 0, 0, 1,
        // configuration, interface, HID, endpoint
        9, 2, CONFIG_SIZE, 0, 1, 1, 0, 0x80, 50, 9, 4, 0, 0, 1, 3, 0, 0, 0, 9, 0x21, 0x11, 1, 0,
        1, 0x22, (uint8_t)said, (uint8_t)(said >> 8), 7, 5, 0x81, 3, (uint8_t)m->packet,
        (uint8_t)(m->packet >> 8), 8};
    memcpy(out, all, sizeof all);
    return m->broken_config ? 18u + m->broken_config : sizeof all;
}

struct mock_device *mock_plug(const struct mock_design *design)
{
    struct mock_device *d = calloc(1, sizeof *d);
    uint8_t bytes[18 + CONFIG_SIZE];
    char text[1024], hex[2 * sizeof bytes + 1];
    GError *error = NULL;
    d->design = *design;
    d->driver = design->has_driver;
    d->counts.led = -1;
    d->script = calloc(MOST_SCRIPT, sizeof *d->script);
    number++;
    snprintf(d->node, sizeof d->node, "/dev/bus/usb/001/%03d", number);
    snprintf(d->path, sizeof d->path, "/devices/usb1/1-%d", number);
    add_hex(hex, bytes, descriptors(design, bytes));
    snprintf(text, sizeof text,
             "P: %s\nN: %s\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: BUSNUM=001\n"
             "E: DEVNUM=%03d\nE: DEVNAME=%s\nA: busnum=1\\n\nA: devnum=%d\\n\n"
             "A: bConfigurationValue=1\\n\nA: speed=12\\n\nH: descriptors=%s\n",
             d->path, d->node + 5, number, d->node, number, hex);
    pthread_mutex_lock(&lock);
    if (n_device == MOST_DEVICES) abort();
    devices[n_device++] = d;
    pthread_mutex_unlock(&lock);
    d->base = umockdev_ioctl_base_new();
    g_signal_connect(d->base, "handle-ioctl", G_CALLBACK(handle), d);
    // Adding it sends the uevent.
    if (!umockdev_testbed_attach_ioctl(testbed, d->node, d->base, &error) ||
        !umockdev_testbed_add_from_string(testbed, text, &error)) {
        fprintf(stderr, "usb_mock: %s\n", error->message);
        abort();
    }
    return d;
}

void mock_unplug(struct mock_device *d)
{
    char sys[80];
    pthread_mutex_lock(&lock);
    d->gone = true;
    for (int i = 0; i < MOST_URBS; i++)
        if (d->urb[i].data && !d->urb[i].done) finish_urb(&d->urb[i], -ESHUTDOWN, NULL, 0);
    serve_reaper(d);
    pthread_mutex_unlock(&lock);
    snprintf(sys, sizeof sys, "/sys%s", d->path);
    umockdev_testbed_uevent(testbed, sys, "remove");
    umockdev_testbed_remove_device(testbed, sys);
}

static void add_script(struct mock_device *d, int error, const void *bytes, size_t n)
{
    pthread_mutex_lock(&lock);
    if (d->n_script == MOST_SCRIPT || n > sizeof d->script->bytes) abort();
    struct script *s = &d->script[d->n_script++];
    s->error = error;
    s->n = n;
    if (n) memcpy(s->bytes, bytes, n);
    run_script(d);
    pthread_mutex_unlock(&lock);
}

void mock_report(struct mock_device *d, const void *bytes, size_t n)
{
    add_script(d, 0, bytes, n);
}

void mock_fault(struct mock_device *d, int error, int n)
{
    for (int i = 0; i < n; i++) add_script(d, error, NULL, 0);
}

struct mock_counts mock_counts(struct mock_device *d)
{
    pthread_mutex_lock(&lock);
    struct mock_counts counts = d->counts;
    pthread_mutex_unlock(&lock);
    return counts;
}

bool mock_drained(struct mock_device *d, int ms)
{
    for (;; ms -= 5) {
        pthread_mutex_lock(&lock);
        bool done = d->at_script == d->n_script;
        for (int i = 0; i < MOST_URBS; i++) done &= !d->urb[i].data || !d->urb[i].done;
        pthread_mutex_unlock(&lock);
        if (done || ms <= 0) return done;
        usleep(5000);
    }
}

void mock_end(void)
{
    if (!testbed) return;
    pthread_mutex_lock(&lock);
    stopping = true;
    pthread_cond_signal(&wake);
    pthread_mutex_unlock(&lock);
    pthread_join(ticker, NULL);
    for (int i = 0; i < n_device; i++) {
        umockdev_testbed_detach_ioctl(testbed, devices[i]->node, NULL);
        g_object_unref(devices[i]->base);
    }
    g_clear_object(&testbed);
    // The devices stay in memory: umockdev's thread may still end an ioctl of a program that
    // was killed.
}
