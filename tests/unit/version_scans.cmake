prt_test(version_scans SOURCES unit/version_scans.c LIBS relightd_rooms LABELS unit)
