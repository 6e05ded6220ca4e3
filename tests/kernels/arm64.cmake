# The tree cross-built for arm64, its kernel and unit tests under qemu (exit 77: not installed).
if(NOT CMAKE_CROSSCOMPILING)
  add_test(NAME arm64 COMMAND ${CMAKE_SOURCE_DIR}/tests/arm64 --no-install)
  set_tests_properties(arm64 PROPERTIES LABELS "kernels;long" TIMEOUT 14400 SKIP_RETURN_CODE 77)
endif()
