pkg_check_modules(OPENSSL REQUIRED IMPORTED_TARGET openssl)
prt_test(tls SOURCES service/tls.c LIBS librelight relight_proto PkgConfig::OPENSSL LABELS service)
target_include_directories(test_tls PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service
  ${CMAKE_SOURCE_DIR}/proto)
add_dependencies(test_tls relightd prt_program)
