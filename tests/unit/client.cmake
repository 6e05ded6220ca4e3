prt_test(client SOURCES unit/client.c LIBS librelight LABELS unit)
