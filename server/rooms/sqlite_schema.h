/* SPDX-License-Identifier: MIT */
/* sqlite_schema.h owns the tables of the embedded store and their versions. */
#ifndef RELIGHTD_ROOMS_SQLITE_SCHEMA_H
#define RELIGHTD_ROOMS_SQLITE_SCHEMA_H

#include <sqlite3.h>

/* Brings a database of any earlier version to this one, in one transaction a version. 0, or -1
 * with the error's text: it is of a later version, or no database of rooms. */
int sqlite_schema_update(sqlite3 *db, char error[256]);
enum { SQLITE_SCHEMA_VERSION = 4, SQLITE_SCHEMA_ID = 0x524c524d /* "RLRM" */ };
/* The statements that lead to a version from the one before; NULL beyond the last. */
const char *sqlite_schema_step(int version);

#endif
