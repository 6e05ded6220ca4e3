// SPDX-License-Identifier: MIT
// Events, tokens and signed links in the vectors.
#include "proto_vectors.h"

enum { LAST = RELIGHT_FRAME_LAST, ANSWER = RELIGHT_TYPE_ANSWER };

static unsigned add_events(struct vector *out, unsigned n)
{
    static Relight__SubscribeRequest subscribe;
    static Relight__EventKind kinds[] = {RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED,
                                         RELIGHT__EVENT_KIND__EVENT_JOB};
    relight__subscribe_request__init(&subscribe);
    subscribe.n_kinds = 2;
    subscribe.kinds = kinds;
    subscribe.run = "09f3c2d1a5b60718";
    subscribe.after = 41;
    n = vector_add(out, n, "subscribe", "C: SUBSCRIBE to models and bakes, after event 41", 20,
                   LAST, 15, &subscribe.base, NULL, 0);
    static Relight__Event first, added;
    relight__event__init(&first);
    first.run = subscribe.run;
    first.sequence = 41;
    n = vector_add(out, n, "event_none", "S: SUBSCRIBE goes on after 41, nothing was lost",
                   20 | ANSWER, 0, 15, &first.base, NULL, 0);
    added = first;
    added.sequence = 44;
    added.kind = RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED;
    added.time_us = UINT64_C(1700000000000000);
    added.model = "3f9ad2c1";
    added.name = "bunny.obj";
    added.state = RELIGHT__MODEL_STATE__MODEL_RECEIVED;
    added.generation = 1;
    n = vector_add(out, n, "event_model", "S: event 44, a model was added", 20 | ANSWER, 0, 15,
                   &added.base, NULL, 0);
    return n;
}

static unsigned add_token(struct vector *out, unsigned n)
{
    static Relight__TokenCreateRequest token;
    static Relight__TokenCreateAnswer token_made;
    static Relight__TokenInfo token_info;
    static Relight__TokenQuotas quotas;
    static char *rights[] = {"view", "upload"};
    relight__token_create_request__init(&token);
    relight__token_quotas__init(&quotas);
    quotas.rate = 20;
    quotas.models = 4;
    token.name = "anna";
    token.n_scopes = 2;
    token.scopes = rights;
    token.lifetime_s = 2592000;
    token.quotas = &quotas;
    relight__token_create_answer__init(&token_made);
    relight__token_info__init(&token_info);
    token_info.name = "anna";
    token_info.n_scopes = 2;
    token_info.scopes = rights;
    token_info.created_s = 1700000000;
    token_info.expires_s = 1702592000;
    token_info.by = "uid:0";
    token_info.quotas = &quotas;
    token_made.token = "relight_AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8";
    token_made.info = &token_info;
    return vector_exchange(out, n, "token_create", 21, 16,
                           "C: TOKEN_CREATE for anna, 30 days, 20 requests/s, 4 models",
                           &token.base, "S: TOKEN_CREATE, the secret of bytes 0 to 31",
                           &token_made.base);
}

unsigned vectors_add_access(struct vector *out, unsigned n)
{
    return add_token(out, add_events(out, n));
}

unsigned vectors_add_link(struct vector *out, unsigned n)
{
    static Relight__SignRequest sign;
    static Relight__SignAnswer link;
    relight__sign_request__init(&sign);
    relight__sign_answer__init(&link);
    sign.url = "/v1/models/bunny/image.jpg?rotate=30&env=studio";
    sign.lifetime_s = 3600;
    // By the token of token_create_answer, named anna.
    link.url = "/v1/models/bunny/image.jpg?by=anna&env=studio&expires=1700003600&rotate=30&sig="
               "F1cu3xt3O0FGPYZrjqZLObxbjMa2JhQo-zIWS6qc9kw";
    link.expires_s = 1700003600;
    return vector_exchange(out, n, "sign", 35, 22, "C: SIGN for an hour", &sign.base,
                           "S: SIGN by anna's token of token_create_answer", &link.base);
}
