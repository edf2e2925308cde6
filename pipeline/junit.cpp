#include "pipeline/junit.h"

#include <pugixml.hpp>
#include <sstream>

namespace limber {

namespace {

/// XML 1.0 has no control characters but tab, line feed and carriage return, escaped or not.
std::string for_xml(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    const bool control = byte < 0x20 && c != '\t' && c != '\n' && c != '\r';
    out += control ? "\xEF\xBF\xBD" : std::string(1, c);
  }
  return out;
}

void set(pugi::xml_node node, const char* name, const std::string& value) {
  node.append_attribute(name).set_value(for_xml(value).c_str());
}

void add_clip(pugi::xml_node suite, const ClipSummary& clip) {
  pugi::xml_node test = suite.append_child("testcase");
  set(test, "classname", clip.source);
  set(test, "name", clip.clip.empty() ? clip.stem : clip.stem + " " + clip.clip);
  if (clip.code.empty()) return;
  if (clip.status == Status::fail) {
    pugi::xml_node failure = test.append_child("failure");
    set(failure, "type", clip.code);
    set(failure, "message", clip.message);
  } else {
    const std::string told = clip.code + ": " + clip.message;
    test.append_child("system-out").text().set(for_xml(told).c_str());
  }
}

}  // namespace

std::string junit_xml(const std::vector<ClipSummary>& clips, const std::string& name) {
  pugi::xml_document document;
  pugi::xml_node suite = document.append_child("testsuites").append_child("testsuite");
  std::size_t failures = 0;
  for (const ClipSummary& clip : clips) failures += clip.status == Status::fail;
  set(suite, "name", name);
  suite.append_attribute("tests").set_value(static_cast<unsigned long long>(clips.size()));
  suite.append_attribute("failures").set_value(static_cast<unsigned long long>(failures));
  suite.append_attribute("errors").set_value(0);
  for (const ClipSummary& clip : clips) add_clip(suite, clip);
  std::ostringstream out;
  document.save(out, "  ", pugi::format_default, pugi::encoding_utf8);
  return out.str();
}

}  // namespace limber
