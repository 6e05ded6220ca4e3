prt_test(librelight SOURCES service/librelight.c LIBS librelight LABELS service TIMEOUT 180)
add_dependencies(test_librelight relightd prt_program)
