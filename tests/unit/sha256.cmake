prt_test(sha256 SOURCES unit/sha256.c unit/sha256_c.c LIBS relight_proto LABELS unit)
