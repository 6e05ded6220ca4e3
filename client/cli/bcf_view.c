// SPDX-License-Identifier: MIT
// The XML of BCF files, and the camera of a viewpoint that another program wrote.
#include "bcf_xml.h"
#include "room.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static void characters(void *user, const XML_Char *text, int n)
{
    struct bcf_xml *x = user;
    for (int i = 0; i < n && x->n + 1 < sizeof x->text; i++) x->text[x->n++] = text[i];
}

// A document type could define entities without end: BCF has none.
static void no_doctype(void *user, const XML_Char *name, const XML_Char *system,
                       const XML_Char *public_id, int internal)
{
    XML_StopParser(((struct bcf_xml *)user)->parser, XML_FALSE);
}

bool bcf_parse(struct bcf_xml *xml, const void *bytes, size_t n, XML_StartElementHandler begins,
               XML_EndElementHandler ends)
{
    if (!(xml->parser = XML_ParserCreate(NULL))) return false;
    XML_SetUserData(xml->parser, xml);
    XML_SetElementHandler(xml->parser, begins, ends);
    XML_SetCharacterDataHandler(xml->parser, characters);
    XML_SetStartDoctypeDeclHandler(xml->parser, no_doctype);
    bool good = XML_Parse(xml->parser, bytes, (int)n, 1) == XML_STATUS_OK;
    XML_ParserFree(xml->parser);
    return good;
}

// ---- a viewpoint

static const char *const vector_names[] = {"CameraViewPoint", "CameraDirection",
                                           "CameraUpVector"};
static const char *const json_names[] = {"eye", "direction", "up"};
enum { ALL_OF_EYE_AND_DIRECTION = 077, ALL_OF_UP = 0700 };

struct viewpoint {
    struct bcf_xml xml; // first
    bool inside, done;  // of the first camera
    bool orthogonal;
    int vector;           // the open element's place in vector_names; 3: none
    unsigned have;        // bits of v that were read
    double v[3][3];       // BCF's axes
    double angle, height; // 0: not known
};

static void view_begins(void *user, const XML_Char *name, const XML_Char **attributes)
{
    struct viewpoint *p = user;
    p->xml.depth++;
    p->xml.n = 0;
    if (p->xml.depth == 2) {
        p->orthogonal = p->done ? p->orthogonal : !strcmp(name, "OrthogonalCamera");
        p->inside = !p->done && (p->orthogonal || !strcmp(name, "PerspectiveCamera"));
    }
    if (p->xml.depth != 3) return;
    for (p->vector = 0; p->vector < 3; p->vector++)
        if (!strcmp(name, vector_names[p->vector])) break;
}

// Reads the element's text as a number of metres, at most 1e6 in size. False: it is none.
static bool read_number(struct bcf_xml *x, double *out)
{
    char *end;
    x->text[x->n] = 0;
    *out = strtod(x->text, &end);
    return end != x->text && end[strspn(end, " \t\r\n")] == 0 && fabs(*out) <= 1e6;
}

static void view_ends(void *user, const XML_Char *name)
{
    struct viewpoint *p = user;
    double x;
    if (p->inside && p->xml.depth == 4 && p->vector < 3 && name[0] >= 'X' && name[0] <= 'Z' &&
        !name[1] && read_number(&p->xml, &x)) {
        p->v[p->vector][name[0] - 'X'] = x;
        p->have |= 1u << (3 * p->vector + name[0] - 'X');
    }
    if (p->inside && p->xml.depth == 3 && read_number(&p->xml, &x)) {
        if (!p->orthogonal && !strcmp(name, "FieldOfView") && x > 0 && x < 170) p->angle = x;
        if (p->orthogonal && !strcmp(name, "ViewToWorldScale") && x > 0) p->height = x;
    }
    if (p->xml.depth == 2 && p->inside) {
        p->done = true;
        p->inside = false;
    }
    p->xml.depth--;
    p->xml.n = 0;
}

static cJSON *view_json(const struct viewpoint *p)
{
    cJSON *json = cJSON_CreateObject();
    int n = (p->have & ALL_OF_UP) == ALL_OF_UP ? 3 : 2;
    for (int i = 0; i < n; i++) {
        // x,y,z with +z up becomes x,z,-y.
        const double v[3] = {p->v[i][0], p->v[i][2], -p->v[i][1]};
        cJSON_AddItemToObject(json, json_names[i], cJSON_CreateDoubleArray(v, 3));
    }
    cJSON_AddNumberToObject(json, "fovy_deg", p->angle);
    cJSON_AddNumberToObject(json, "height", p->height);
    return json;
}

cJSON *bcf_view_read(const void *bytes, size_t n)
{
    struct viewpoint *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    bool good = bcf_parse(&p->xml, bytes, n, view_begins, view_ends) &&
                (p->have & ALL_OF_EYE_AND_DIRECTION) == ALL_OF_EYE_AND_DIRECTION;
    cJSON *json = good ? view_json(p) : NULL;
    free(p);
    return json;
}

bool bcf_view_of(const cJSON *json, struct bcf_view *out)
{
    double *const v[] = {out->eye, out->direction, out->up};
    *out = (struct bcf_view){.fovy_deg = number_of(json, "fovy_deg"),
                             .height = number_of(json, "height")};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const cJSON *x = cJSON_GetArrayItem(list_of(json, json_names[i]), k);
            v[i][k] = cJSON_IsNumber(x) ? x->valuedouble : 0;
        }
    const double *d = out->direction;
    double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    if (!(length > 1e-9)) return false;
    for (int k = 0; k < 3; k++) out->direction[k] /= length;
    return true;
}
