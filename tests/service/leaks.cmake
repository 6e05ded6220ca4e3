# Memory and descriptors of the programs, by gcc's leak sanitizer, preloaded. Builds with a sanitizer
# look for leaks in every test.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
find_library(LSAN_LIBRARY NAMES liblsan.so.0 liblsan.so)
if(SYSTEM_PYTHON3 AND LSAN_LIBRARY AND NOT PRT_SANITIZE)
  add_test(NAME leaks COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/leaks.py
    ${CMAKE_BINARY_DIR}/bin ${LSAN_LIBRARY})
  set_tests_properties(leaks PROPERTIES LABELS service SKIP_RETURN_CODE 77)
else()
  message(STATUS "no liblsan or python3, or a sanitizer's build: the test leaks is left out")
endif()
