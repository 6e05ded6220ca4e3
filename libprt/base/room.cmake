# The system-call filter of isolate.c; without libseccomp only the limits remain.
pkg_check_modules(SECCOMP IMPORTED_TARGET libseccomp)
if(SECCOMP_FOUND)
  target_link_libraries(prt_base PUBLIC PkgConfig::SECCOMP)
  target_compile_definitions(prt_base PRIVATE PRT_HAVE_SECCOMP)
endif()
