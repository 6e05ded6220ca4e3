# The system-call filter of sandbox.c. A build without it decodes no file unless every program is
# told to (--accept-weak-sandbox).
option(PRT_WEAK_SANDBOX "build without libseccomp" OFF)
if(NOT PRT_WEAK_SANDBOX)
  pkg_check_modules(SECCOMP REQUIRED IMPORTED_TARGET libseccomp)
  target_link_libraries(prt_base PUBLIC PkgConfig::SECCOMP)
  target_compile_definitions(prt_base PRIVATE PRT_HAVE_SECCOMP)
endif()
