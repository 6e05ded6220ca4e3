// SPDX-License-Identifier: MIT
// Pins as a BCF 2.1 file: a topic a pin, with its notes, camera and picture. BCF has metres
// with +z up and names neither triangle nor light, so each topic's folder also holds the pin as
// JSON.
#include "bcf_xml.h"
#include "room.h"
#include "zip.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// ---- writing

// A BCF GUID, 8-4-4-4-12 hex digits, from the room's id, the kind of item and its sequence.
static void guid_of(char out[40], const cJSON *state, unsigned kind, double sequence)
{
    const char *room = text_of(state, "room");
    snprintf(out, 40, "%.8s-%.4s-4%.3s-8%03x-%012llx", room, room + 8, room + 12, kind & 0xfff,
             (unsigned long long)sequence & 0xffffffffffffull);
}

static void put_xml(FILE *out, const char *text)
{
    for (; *text; text++) {
        unsigned char c = (unsigned char)*text;
        if (c == '&') fputs("&amp;", out);
        else if (c == '<') fputs("&lt;", out);
        else if (c == '>') fputs("&gt;", out);
        else if (c == '"') fputs("&quot;", out);
        else if (!strncmp(text, "\xef\xbf\xbe", 3) || !strncmp(text, "\xef\xbf\xbf", 3)) {
            fputs("\xef\xbf\xbd", out); // U+FFFE and U+FFFF are no characters of XML
            text += 2;
        } else if (c >= ' ' || c == '\n' || c == '\t') fputc(c, out);
        else fputc(' ', out); // XML 1.0 has no other control characters
    }
}

static void put_element(FILE *out, const char *name, const char *text)
{
    fprintf(out, "<%s>", name);
    put_xml(out, text);
    fprintf(out, "</%s>\n", name);
}

static void put_head(FILE *out)
{
    fputs("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n", out);
}

// A title is one line: the first of the pin's text.
static void put_title(FILE *out, const char *text)
{
    char line[120];
    size_t n = strcspn(text, "\n");
    if (n >= sizeof line) n = whole_characters(text, sizeof line - 1);
    snprintf(line, sizeof line, "%.*s", (int)n, text);
    put_element(out, "Title", *line ? line : "(erased)");
}

static void put_comment(FILE *out, const cJSON *state, const cJSON *note, const char *viewpoint)
{
    const cJSON *stamp = list_of(note, "stamp");
    char guid[40], date[32];
    guid_of(guid, state, 2, number_of(stamp, "sequence"));
    print_utc(date, number_of(stamp, "time_us"));
    fprintf(out, "<Comment Guid=\"%s\">\n", guid);
    put_element(out, "Date", date);
    put_element(out, "Author", author_of(stamp));
    put_element(out, "Comment", text_of(note, "text"));
    if (viewpoint) fprintf(out, "<Viewpoint Guid=\"%s\"/>\n", viewpoint);
    if (number_of(note, "changed_us") > 0) {
        print_utc(date, number_of(note, "changed_us"));
        put_element(out, "ModifiedDate", date);
        put_element(out, "ModifiedAuthor", author_of(stamp));
    }
    fputs("</Comment>\n", out);
}

// viewpoint: NULL for none.
static void put_markup(FILE *out, const cJSON *state, const cJSON *pin, const char *topic,
                       const char *viewpoint)
{
    const cJSON *stamp = list_of(pin, "stamp"), *notes = list_of(pin, "notes"), *note;
    const char *text = text_of(cJSON_GetArrayItem(notes, 0), "text");
    char date[32];
    put_head(out);
    fprintf(out, "<Markup>\n<Topic Guid=\"%s\" TopicType=\"Review\" TopicStatus=\"%s\">\n",
            topic, cJSON_IsTrue(list_of(pin, "resolved")) ? "Closed" : "Open");
    put_title(out, text);
    print_utc(date, number_of(stamp, "time_us"));
    put_element(out, "CreationDate", date);
    put_element(out, "CreationAuthor", author_of(stamp));
    put_element(out, "Description", text);
    fputs("<DocumentReference isExternal=\"false\">"
          "<ReferencedDocument>pin.json</ReferencedDocument>"
          "<Description>the pin of the review room: point of the surface, scene, hashes"
          "</Description></DocumentReference>\n</Topic>\n",
          out);
    cJSON_ArrayForEach(note, notes) if (*text_of(note, "text"))
        put_comment(out, state, note, viewpoint);
    if (viewpoint)
        fprintf(out,
                "<Viewpoints Guid=\"%s\"><Viewpoint>viewpoint.bcfv</Viewpoint>"
                "<Snapshot>snapshot.png</Snapshot></Viewpoints>\n",
                viewpoint);
    fputs("</Markup>\n", out);
}

static void put_vector(FILE *out, const char *name, const double v[3])
{
    // x,y,z with +y up becomes x,-z,y.
    fprintf(out, "<%s><X>%.9g</X><Y>%.9g</Y><Z>%.9g</Z></%s>\n", name, v[0], -v[2], v[1], name);
}

static void put_viewpoint(FILE *out, const char *guid, const struct relight_camera *camera,
                          double metres_per_unit)
{
    double eye[3], towards[3], up[3], length = 0;
    for (int k = 0; k < 3; k++) {
        eye[k] = (double)camera->eye[k] * metres_per_unit;
        towards[k] = (double)camera->target[k] - (double)camera->eye[k];
        up[k] = (double)camera->up[k];
        length += towards[k] * towards[k];
    }
    for (int k = 0; k < 3; k++) towards[k] /= length > 0 ? sqrt(length) : 1;
    double fovy = (double)camera->fovy_deg;
    put_head(out);
    fprintf(out, "<VisualizationInfo Guid=\"%s\">\n<PerspectiveCamera>\n", guid);
    put_vector(out, "CameraViewPoint", eye);
    put_vector(out, "CameraDirection", towards);
    put_vector(out, "CameraUpVector", up);
    // The schema of 2.1 allows 45 to 60 degrees.
    fprintf(out,
            "<FieldOfView>%.9g</FieldOfView>\n</PerspectiveCamera>\n</VisualizationInfo>\n",
            fovy < 45   ? 45
            : fovy > 60 ? 60
                        : fovy);
}

struct text_file {
    FILE *stream;
    char *text;
    size_t n;
};

static void add_text(struct zip_writer *zip, const char *folder, const char *name,
                     struct text_file *file)
{
    char path[120];
    if (fclose(file->stream)) zip->failed = true;
    snprintf(path, sizeof path, "%s%s%s", folder, *folder ? "/" : "", name);
    zip_add(zip, path, file->text, file->n);
    free(file->text);
}

static bool open_text(struct zip_writer *zip, struct text_file *file)
{
    file->stream = open_memstream(&file->text, &file->n);
    if (!file->stream) zip->failed = true;
    return file->stream;
}

// The scene of the pin's revision is exported, too, so that the room that imports it is
// complete.
static cJSON *pin_record(const cJSON *state, const cJSON *pin)
{
    cJSON *record = cJSON_CreateObject();
    const cJSON *revision = cJSON_GetArrayItem(
        list_of(state, "revisions"), (int)number_of(list_of(pin, "seen"), "revision") - 1);
    cJSON_AddItemToObject(record, "pin", cJSON_Duplicate(pin, 1));
    if (revision)
        cJSON_AddItemToObject(record, "scene", cJSON_Duplicate(list_of(revision, "scene"), 1));
    return record;
}

// Of the pin's model: the room may show one of another scale by now.
static double metres_per_unit(struct room_call *c, const cJSON *pin)
{
    struct relight_model model;
    const char *id = text_of(list_of(pin, "seen"), "model");
    if (!*id || relight_info(c->client, id, &model, &c->error)) return 1e-3;
    double mm = model.mm_per_unit;
    relight_model_finish(&model);
    return mm > 0 ? mm * 1e-3 : 1e-3;
}

// The picture, and the camera that drew it. False: it is not drawn.
static bool add_view(struct room_call *c, struct zip_writer *zip, const cJSON *pin,
                     const char *topic, const char *viewpoint)
{
    struct relight_room_view view = {.format = RELIGHT_IMAGE_PNG};
    struct relight_image image;
    struct text_file file;
    char path[120];
    view.pin = (uint64_t)number_of(list_of(pin, "stamp"), "sequence");
    if (relight_room_picture(c->client, c->room, &view, &image, &c->error)) return false;
    snprintf(path, sizeof path, "%s/snapshot.png", topic);
    zip_add(zip, path, image.data, image.n_byte);
    if (open_text(zip, &file)) {
        put_viewpoint(file.stream, viewpoint, &image.camera, metres_per_unit(c, pin));
        add_text(zip, topic, "viewpoint.bcfv", &file);
    }
    relight_image_finish(&image);
    return true;
}

static int add_topic(struct room_call *c, struct zip_writer *zip, const cJSON *state,
                     const cJSON *pin)
{
    double sequence = number_of(list_of(pin, "stamp"), "sequence");
    struct text_file file;
    char topic[40], viewpoint[40], path[120];
    guid_of(topic, state, 0, sequence);
    guid_of(viewpoint, state, 1, sequence);
    bool drawn = add_view(c, zip, pin, topic, viewpoint);
    snprintf(path, sizeof path, "the view of pin %.0f in pins.bcf", sequence);
    int status = drawn ? EXIT_DONE : room_left_out(c, path);
    if (status) return status;
    if (open_text(zip, &file)) {
        put_markup(file.stream, state, pin, topic, drawn ? viewpoint : NULL);
        add_text(zip, topic, "markup.bcf", &file);
    }
    cJSON *record = pin_record(state, pin);
    char *text = cJSON_Print(record);
    cJSON_Delete(record);
    snprintf(path, sizeof path, "%s/pin.json", topic);
    if (text) zip_add(zip, path, text, strlen(text));
    else zip->failed = true;
    free(text);
    return EXIT_DONE;
}

int bcf_write(struct room_call *c, const cJSON *state, const char *path)
{
    struct zip_writer zip = {0};
    struct text_file file;
    const cJSON *pin;
    int status = EXIT_DONE;
    size_t n;
    static const char version[] =
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
        "<Version VersionId=\"2.1\"><DetailedVersion>2.1</DetailedVersion></Version>\n";
    zip_add(&zip, "bcf.version", version, sizeof version - 1);
    if (open_text(&zip, &file)) {
        put_head(file.stream);
        fprintf(file.stream, "<ProjectExtension><Project ProjectId=\"%s\">\n",
                text_of(state, "room"));
        put_element(file.stream, "Name", text_of(state, "name"));
        fputs("</Project><ExtensionSchema></ExtensionSchema></ProjectExtension>\n",
              file.stream);
        add_text(&zip, "", "project.bcfp", &file);
    }
    cJSON_ArrayForEach(pin, list_of(state, "pins"))
    {
        if (!status) status = add_topic(c, &zip, state, pin);
    }
    uint8_t *bytes = zip_finish(&zip, &n);
    if (!status && !bytes) {
        c->error = (struct relight_error){.code = RELIGHT_E_NO_MEMORY};
        snprintf(c->error.text, sizeof c->error.text, "%s: too large for one BCF file", path);
        status = room_failed(c);
    }
    if (!status) status = write_file(c->options, path, bytes, n);
    free(bytes);
    return status;
}

// ---- reading

struct markup {
    struct bcf_xml xml; // first
    cJSON *topic;       // the topic that the file is read into
    cJSON *comment;     // the one that is open
    unsigned depth;     // of that one
};

// BCF 2.1 has comments beside the topic, 3.0 in a list inside it.
static bool is_comment(const struct markup *m, const char *name)
{
    return (m->xml.depth == 2 || m->xml.depth == 4) && !strcmp(name, "Comment");
}

static void element_begins(void *user, const XML_Char *name, const XML_Char **attributes)
{
    struct markup *m = user;
    m->xml.depth++;
    m->xml.n = 0;
    if (!m->comment && is_comment(m, name)) {
        m->comment = cJSON_CreateObject();
        m->depth = m->xml.depth;
        cJSON_AddItemToArray(cJSON_GetObjectItem(m->topic, "comments"), m->comment);
    }
    if (m->xml.depth == 2 && !strcmp(name, "Topic"))
        for (int i = 0; attributes[i]; i += 2)
            if (!strcmp(attributes[i], "TopicStatus"))
                cJSON_AddStringToObject(m->topic, "status", attributes[i + 1]);
}

static void element_ends(void *user, const XML_Char *name)
{
    struct markup *m = user;
    static const char *const of_topic[] = {"Title", "Description", "CreationAuthor",
                                           "CreationDate"};
    static const char *const of_comment[] = {"Comment", "Author", "Date"};
    const unsigned depth = m->xml.depth--;
    m->xml.text[m->xml.n] = 0;
    if (depth == m->depth) m->comment = NULL;
    for (int i = 0; i < 4 && !m->comment && depth == 3; i++)
        if (!strcmp(name, of_topic[i])) cJSON_AddStringToObject(m->topic, name, m->xml.text);
    // Of several viewpoints the first; BCF 3.0 has them inside the topic, too.
    if (!m->comment && (depth == 3 || depth == 5) && !strcmp(name, "Viewpoint") && m->xml.n &&
        !cJSON_GetObjectItem(m->topic, "viewpoint"))
        cJSON_AddStringToObject(m->topic, "viewpoint", m->xml.text);
    for (int i = 0; i < 3 && m->comment && depth == m->depth + 1; i++)
        if (!strcmp(name, of_comment[i]))
            cJSON_AddStringToObject(m->comment, name, m->xml.text);
    m->xml.n = 0;
}

static cJSON *parse_markup(const struct zip_file *file)
{
    struct markup *m = calloc(1, sizeof *m);
    cJSON *topic = cJSON_CreateObject();
    cJSON_AddArrayToObject(topic, "comments");
    if (m) m->topic = topic;
    if (!m || !bcf_parse(&m->xml, file->bytes, file->n, element_begins, element_ends)) {
        cJSON_Delete(topic);
        topic = NULL;
    }
    free(m);
    return topic;
}

static const struct zip_file *beside(const struct zip_file *files, size_t n, const char *markup,
                                     const char *name)
{
    char path[300];
    snprintf(path, sizeof path, "%.*s%s", (int)(strrchr(markup, '/') - markup) + 1, markup,
             name);
    for (size_t i = 0; i < n; i++)
        if (!strcmp(files[i].name, path)) return &files[i];
    return NULL;
}

static int bad_file(struct room_call *c, const char *path, const char *what)
{
    c->error = (struct relight_error){.code = RELIGHT_E_FORMAT};
    snprintf(c->error.text, sizeof c->error.text, "%.200s: %.160s", path, what);
    return room_failed(c);
}

static uint8_t *read_all(const char *path, size_t *n)
{
    FILE *file = fopen(path, "rbe");
    uint8_t *bytes = file ? malloc(ZIP_MOST_BYTES) : NULL;
    *n = bytes ? fread(bytes, 1, ZIP_MOST_BYTES, file) : 0;
    bool good = bytes && !ferror(file) && *n < ZIP_MOST_BYTES;
    if (file) fclose(file);
    if (good) return bytes;
    free(bytes);
    return NULL;
}

int bcf_read(struct room_call *c, const char *path, cJSON **topics)
{
    size_t n, n_file = 0;
    char fault[160] = "it can not be read";
    struct zip_file *files = NULL;
    uint8_t *bytes = read_all(path, &n);
    int failed = bytes ? zip_read(bytes, n, &files, &n_file, fault) : -1;
    free(bytes);
    if (failed) return bad_file(c, path, fault);
    *topics = cJSON_CreateArray();
    for (size_t i = 0; i < n_file && !failed; i++) {
        const char *end = strrchr(files[i].name, '/');
        if (!end || strcmp(end, "/markup.bcf")) continue;
        cJSON *topic = parse_markup(&files[i]);
        const char *name = topic ? text_of(topic, "viewpoint") : "";
        const struct zip_file *view =
            beside(files, n_file, files[i].name, *name ? name : "viewpoint.bcfv");
        const struct zip_file *own = beside(files, n_file, files[i].name, "pin.json");
        cJSON *pin = own ? cJSON_ParseWithLength((const char *)own->bytes, own->n) : NULL;
        if (topic && pin) cJSON_AddItemToObject(topic, "relight", pin);
        if (topic && view && !pin)
            cJSON_AddItemToObject(topic, "view", bcf_view_read(view->bytes, view->n));
        if (topic) cJSON_AddItemToArray(*topics, topic);
        else failed = 1;
        if (!topic) cJSON_Delete(pin);
    }
    zip_free(files, n_file);
    if (!failed) return EXIT_DONE;
    cJSON_Delete(*topics);
    return bad_file(c, path, "a markup.bcf in it is no XML of BCF");
}
