prt_test(header SOURCES unit/header.c LIBS relight_proto LABELS unit)
