#pragma once

#include <exception>
#include <new>
#include <string>
#include <utility>

#include "assets/model/result.h"

namespace limber {

/// How the readers stop inside this module: deep in a parser a throw is plainer than a chain of
/// Results. `guarded` turns it into a Result; no exception leaves the module.
struct Failure {
  Error error;
};

[[noreturn]] inline void fail(std::string code, std::string message, std::string hint = {}) {
  throw Failure{
      Error{.code = std::move(code), .message = std::move(message), .hint = std::move(hint)}};
}

/// Runs `body`, which returns a T, and returns its value or the reason why it stopped.
template <class T, class Body>
Result<T> guarded(Body&& body) {
  try {
    return body();
  } catch (Failure& failure) {
    return std::move(failure.error);
  } catch (const std::bad_alloc&) {
    return Error{.code = "out-of-memory",
                 .message = "the file needs more memory than there is",
                 .hint = "check that the file is what it claims to be; split it if it is"};
  } catch (const std::exception& e) {
    return Error{.code = "import-internal",
                 .message = std::string("unexpected: ") + e.what(),
                 .hint = "please report this file: it found a bug in Limber"};
  }
}

}  // namespace limber
