pkg_check_modules(ZLIB_TEST REQUIRED IMPORTED_TARGET zlib)
prt_test(children SOURCES service/children.c LIBS librelight PkgConfig::ZLIB_TEST LABELS service)
target_include_directories(test_children PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_children relightd prt_program)
