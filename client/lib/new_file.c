// SPDX-License-Identifier: MIT
#include "new_file.h"

#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

int relight_new_file(struct new_file *out, const char *path, struct relight_error *error)
{
    struct stat st;
    *out = (struct new_file){.path = path};
    bool special = !stat(path, &st) && !S_ISREG(st.st_mode);
    if (!special && snprintf(out->temporary, sizeof out->temporary, "%s.tmp-%ld", path,
                             (long)getpid()) >= (int)sizeof out->temporary)
        return relight_fail(error, RELIGHT_E_FILE, "", "%.80s...: the path is too long", path);
    out->file = fopen(special ? path : out->temporary, "wbe");
    return out->file ? 0
                     : relight_fail(error, RELIGHT_E_FILE, "", "%s: %s", path, strerror(errno));
}

int relight_new_file_end(struct new_file *f, int status, struct relight_error *error)
{
    const bool special = !f->temporary[0];
    bool bad = fflush(f->file) || (!special && fsync(fileno(f->file)));
    int fault = bad ? errno : 0;
    if (fclose(f->file) && !fault) fault = errno;
    if (!status && !fault && !special && rename(f->temporary, f->path)) fault = errno;
    if (!status && fault)
        status = relight_fail(error, RELIGHT_E_FILE, "", "%s: %s", f->path, strerror(fault));
    if (status && !special) unlink(f->temporary);
    return status;
}
