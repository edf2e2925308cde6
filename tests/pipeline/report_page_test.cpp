// The page of a batch: what it says, that nothing in it can act, and that it needs nothing else.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <regex>

#include "tests/pipeline/program.h"

namespace {

using limber_test::Folder;
using limber_test::limber;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;

namespace fs = std::filesystem;

/// A report of a clip that was solved.
json report(const std::string& status = "pass") {
  return json::parse(R"({
    "schema": "limber-report/1", "limber_version": "1", "status": ")" +
                     status + R"(", "errors": [], "warnings": [],
    "source": {"path": "in/walk.bvh", "format": "bvh", "rate_hz": 120.0, "joints": 38},
    "target": {"path": "hero.glb", "rig": "hero"},
    "output": {"files": [{"path": "x.glb"}], "frames": 240, "rate_hz": 120.0, "duration_s": 2.0},
    "effectors": [
      {"name": "hips", "reachable_frames": 240, "position_error_mm": {"median": 1, "p95": 20, "max": 30}},
      {"name": "head", "reachable_frames": 240, "position_error_mm": {"median": 1, "p95": 44.44444, "max": 9}}],
    "limits": {"joints": 20, "violations": 0, "source_excess_deg": 12.5,
      "bent": [{"joint": "knee", "frames": 40, "max_deg": 12.5, "frames_by_excess": [0, 10, 20, 10, 0, 0]}],
      "at_limit": [{"joint": "knee", "frames": 60}]},
    "contacts": {"source": {"slide_cm_s": 4.5, "penetration_cm": 1}, "output": {"slide_cm_s": 6.0, "penetration_cm": 0.5}},
    "timeline": {"samples": 4, "error_mm": [0, 10, 63, 31.5], "left_contact": [1, 1, 0, 0], "right_contact": [0, 1, 1, 0]}
  })");
}

void write_report(const Folder& folder, const std::string& stem, const json& document) {
  write_text(folder / (stem + ".report.json"), document.dump());
}

struct Page {
  int exit_code = 0;
  std::string html;
  json clips, batch;
};

/// What stands between an element's tags.
std::string element(const std::string& html, const std::string& open, const std::string& close) {
  const std::size_t begin = html.find(open);
  if (begin == std::string::npos) return {};
  const std::size_t end = html.find(close, begin + open.size());
  return html.substr(begin + open.size(), end - begin - open.size());
}

Page page_of(const Folder& folder, const std::string& output = "index.html") {
  const fs::path path = folder / output;
  Page page;
  page.exit_code = limber({"report", folder.string(), "-o", path.string()}).exit_code;
  page.html = text_of(path);
  const auto data = [&](const std::string& id) {
    const std::string open = "<script type=\"application/json\" id=\"" + id + "\">";
    return json::parse(element(page.html, open, "</script>"), nullptr, false);
  };
  page.clips = data("clips-data");
  page.batch = data("batch-data");
  return page;
}

json figure_of(const Page& page, int clip, const std::string& label) {
  for (std::size_t i = 0; i < page.batch["metrics"].size(); ++i) {
    if (page.batch["metrics"][i]["label"] == label) return page.clips[clip]["metrics"][i];
  }
  return "no such metric";
}

std::size_t count(const std::string& text, const std::string& part) {
  std::size_t n = 0;
  for (std::size_t i = text.find(part); i != std::string::npos; i = text.find(part, i + 1)) ++n;
  return n;
}

TEST(ReportPage, RowsSayWhatReportsSay) {
  const Folder folder;
  write_report(folder, "walk@hero", report("warn"));
  write_text(folder / "walk@hero.png", "");
  const Page page = page_of(folder);
  ASSERT_EQ(page.exit_code, 0);
  ASSERT_EQ(page.clips.size(), 1U);
  const json& clip = page.clips[0];
  const json& names = page.batch["names"];
  EXPECT_EQ(clip["base"], "walk%40hero");
  EXPECT_EQ(clip["name"], "walk@hero");
  EXPECT_EQ(names[clip["target"].get<int>()], "hero");
  EXPECT_EQ(clip["status"], 1);
  EXPECT_EQ(clip["sheet"], 1);
  EXPECT_EQ(clip["frames"], 240);
  EXPECT_EQ(figure_of(page, 0, "Effector error, p95"), json(44.44)) << "the worst effector's";
  EXPECT_EQ(figure_of(page, 0, "Effector error, largest"), json(30));
  EXPECT_EQ(figure_of(page, 0, "Slide beyond the source's"), json(1.5));
  EXPECT_EQ(figure_of(page, 0, "Penetration beyond the source's"), json(0));
  EXPECT_EQ(figure_of(page, 0, "Longest on a limit"), json(25)) << "60 of 240 frames";
  EXPECT_TRUE(figure_of(page, 0, "Pops").is_null()) << "not measured";
  ASSERT_EQ(clip["limits"].size(), 1U);
  EXPECT_EQ(names[clip["limits"][0][0].get<int>()], "knee");
  EXPECT_EQ(clip["bent"][0][3], json({0, 10, 20, 10, 0, 0}));
  // 63rds of the peak, 63: 0, 10, 63 and 31.5, which rounds up to 32.
  EXPECT_EQ(clip["timeline"]["error"], json({63, "AK_g"}));
  EXPECT_EQ(clip["timeline"]["contacts"], "BDCA");
}

TEST(ReportPage, FindingsComeWithTheirMeaning) {
  const Folder folder;
  json failed = report("fail");
  failed["errors"] = {
      {{"code", "limits-violated"}, {"message", "3"}, {"joint", "knee"}, {"frame", 7}}};
  failed["warnings"] = {{{"code", "never-heard-of"}, {"message", "m"}}};
  write_report(folder, "walk@hero", failed);
  const Page page = page_of(folder);
  const json& findings = page.clips[0]["findings"];
  ASSERT_EQ(findings.size(), 2U);
  EXPECT_EQ(page.batch["names"][findings[0][0].get<int>()], "limits-violated");
  EXPECT_EQ(findings[0][1], 1);
  EXPECT_EQ(findings[0][4], 7);
  EXPECT_EQ(findings[1][1], 0);
  EXPECT_FALSE(page.batch["codes"]["limits-violated"][0].get<std::string>().empty());
  EXPECT_FALSE(page.batch["codes"].contains("never-heard-of"));
}

/// Names that try to leave their place.
std::vector<std::string> hostile_texts() {
  return {"</script><script>window.owned = 1</script>",
          "<!--<script>",
          "\"><img src=x onerror=\"window.owned = 1\">",
          "\x1b[31mred\x1b[0m\a\b",
          "\u202egnp.exe\u2066\u200f",
          "line\u2028and\u2029paragraph",
          "javascript:window.owned=1",
          "{{script}}{{clips}}&lt;/script&gt;",
          "%00%2e%2e/",
          std::string(4096, 'x'),
          "__proto__"};
}

Page hostile_page(const Folder& folder) {
  int i = 0;
  for (const std::string& text : hostile_texts()) {
    json hostile = report(i % 2 == 0 ? "fail" : "warn");
    for (const char* key : {"path", "clip", "format", "convention", "reader"}) {
      hostile["source"][key] = text;
    }
    hostile["errors"] = {{{"code", text}, {"message", text}, {"joint", text}, {"frame", 1}}};
    hostile["effectors"][0]["name"] = text;
    hostile["limits"]["bent"][0]["joint"] = text;
    hostile["limits"]["at_limit"][0]["joint"] = text;
    hostile["output"]["files"][0]["path"] = text;
    std::string stem = std::to_string(i++) + text.substr(0, 90) + "@" + text.substr(0, 90);
    std::ranges::replace(stem, '/', '_');
    write_report(folder, stem, hostile);
    write_text(folder / (stem + ".png"), "");
  }
  return page_of(folder);
}

TEST(ReportPage, HostileNamesAreInert) {
  const Folder folder;
  const Page page = hostile_page(folder);
  ASSERT_EQ(page.exit_code, 0);
  ASSERT_EQ(page.clips.size(), hostile_texts().size());
  EXPECT_EQ(count(page.html, "<script"), 3U) << "two blocks of data, one script";
  EXPECT_EQ(count(page.html, "</script"), 3U);
  EXPECT_EQ(count(page.html, "<!--"), 0U);
  EXPECT_EQ(count(page.html, "<img"), 0U);
  EXPECT_TRUE(std::ranges::all_of(page.html, [](char c) {
    return c == '\n' || (c >= ' ' && c <= '~');
  })) << "plain ASCII: no control character, no turn of the writing direction";
  // What was hostile is still told, as text, cut to 200 bytes.
  for (const json& clip : page.clips) {
    const std::string source = clip["source"];
    EXPECT_TRUE(std::ranges::any_of(hostile_texts(), [&](const std::string& text) {
      return text == source || text.substr(0, 200) + "\u2026" == source;
    })) << source;
    EXPECT_LE(source.size(), 203U);
    EXPECT_TRUE(std::regex_match(clip["base"].get<std::string>(), std::regex("[-A-Za-z0-9._~%]+")));
    EXPECT_TRUE(clip["files"].empty()) << "files are linked under the report's own name alone";
  }
}

/// What a shell prints, without the line's end.
std::string printed(const std::string& command) {
  FILE* pipe = ::popen(command.c_str(), "r");
  std::string out;
  std::array<char, 256> buffer;
  while (pipe != nullptr && std::fgets(buffer.data(), buffer.size(), pipe) != nullptr)
    out += buffer.data();
  if (pipe != nullptr) ::pclose(pipe);
  while (!out.empty() && out.back() == '\n') out.pop_back();
  return out;
}

TEST(ReportPage, RunsAndLoadsNothingButItself) {
  const Folder folder;
  write_report(folder, "walk@hero", report());
  const Page page = page_of(folder);
  EXPECT_FALSE(std::regex_search(page.html, std::regex("\\{\\{[a-z]+\\}\\}")))
      << "a place left unfilled";
  // No address but the names of the SVG space and links within the page.
  for (const std::string scheme : {"http:", "https:", "ws:", "wss:", "//"}) {
    for (std::size_t i = page.html.find(scheme + "/"); i != std::string::npos;
         i = page.html.find(scheme + "/", i + 1)) {
      EXPECT_EQ(page.html.substr(i, 26), "http://www.w3.org/2000/svg");
    }
  }
  const std::string markup = page.html.substr(0, page.html.find("<script"));
  const std::regex address("(?:src|href|srcset|action|data)=\"([^\"]*)\"");
  for (std::sregex_iterator i(markup.begin(), markup.end(), address), end; i != end; ++i) {
    const std::string target = (*i)[1];
    EXPECT_TRUE(target == "data:," || target.starts_with("#")) << target;
  }
  const std::string style = element(page.html, "<style>", "</style>");
  EXPECT_EQ(style.find("url("), std::string::npos);
  EXPECT_EQ(style.find("@import"), std::string::npos);
  const std::string script = element(page.html, "<script>", "</script>");
  for (const char* sink :
       {"innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "Function(",
        "fetch(", "XMLHttpRequest", "import(", "setAttribute('style'"}) {
    EXPECT_EQ(script.find(sink), std::string::npos) << sink;
  }
  EXPECT_FALSE(std::regex_search(markup, std::regex(" on[a-z]+=| style=")));
}

TEST(ReportPage, ItsPolicyAllowsItsOwnScriptAndStyleAlone) {
  const Folder folder;
  write_report(folder, "walk@hero", report());
  const Page page = page_of(folder);
  const std::string policy = element(page.html, "Content-Security-Policy\" content=\"", "\"");
  EXPECT_TRUE(policy.starts_with("default-src 'none';")) << policy;
  EXPECT_EQ(policy.find("unsafe"), std::string::npos);
  for (const auto& [directive, tag] :
       {std::pair<std::string, std::string>{"style-src", "style"}, {"script-src", "script"}}) {
    write_text(folder / "inline", element(page.html, "<" + tag + ">", "</" + tag + ">"));
    const std::string wanted =
        printed("sha256sum < '" + (folder / "inline").string() + "' | cut -c1-64");
    ASSERT_EQ(wanted.size(), 64U);
    const std::string hash = element(policy, directive + " 'sha256-", "'");
    EXPECT_EQ(printed("printf %s '" + hash + "' | base64 -d | od -An -v -tx1 | tr -d ' \\n'"),
              wanted)
        << directive;
  }
}

TEST(ReportPage, SameReportsSameBytes) {
  const Folder folder;
  for (const char* stem : {"b@hero", "a@hero", "c@hero"}) write_report(folder, stem, report());
  const std::string first = page_of(folder).html;
  ASSERT_FALSE(first.empty());
  // Written again in another order, beside the page that is there already.
  for (const char* stem : {"c@hero", "a@hero", "b@hero"}) {
    fs::remove(folder / (std::string(stem) + ".report.json"));
    write_report(folder, stem, report());
  }
  EXPECT_EQ(page_of(folder).html, first);
  EXPECT_EQ(page_of(folder).clips[0]["name"], "a@hero");
}

TEST(ReportPage, LinksLeadFromThePageToTheSheet) {
  const Folder folder;
  fs::create_directories(folder / "hero #1");
  fs::create_directories(folder / "pages");
  write_report(folder, "hero #1/walk: 100%?@hero", report());
  EXPECT_EQ(page_of(folder).clips[0]["base"], "hero%20%231/walk%3A%20100%25%3F%40hero");
  EXPECT_EQ(page_of(folder, "pages/index.html").clips[0]["base"],
            "../hero%20%231/walk%3A%20100%25%3F%40hero");
}

TEST(ReportPage, ADamagedReportCostsOneRow) {
  const Folder folder;
  write_report(folder, "good@hero", report());
  write_text(folder / "cut@hero.report.json", report().dump().substr(0, 300));
  write_text(folder / "other@hero.report.json", R"({"schema": "other/1", "status": "pass"})");
  write_text(
      folder / "odd@hero.report.json",
      R"({"schema": "limber-report/1", "status": 7, "errors": {"a": 1}, "warnings": [3, null],
                 "source": [], "output": {"frames": "many"}, "effectors": [[], {"name": {}}],
                 "limits": {"at_limit": [1], "bent": "x"}, "timeline": {"error_mm": ["a", -1e99, 7]}})");
  write_text(folder / "deep@hero.report.json", std::string(100000, '['));
  const Page page = page_of(folder);
  EXPECT_EQ(page.exit_code, 1);
  ASSERT_EQ(page.clips.size(), 5U);
  for (const json& clip : page.clips) {
    EXPECT_EQ(clip["status"], clip["name"] == "good@hero" ? 0 : 2) << clip["name"];
    if (clip["name"] == "good@hero" || clip["name"] == "odd@hero") continue;
    EXPECT_EQ(page.batch["names"][clip["findings"][0][0].get<int>()], "report-unreadable");
  }
  EXPECT_TRUE(page.batch["codes"].contains("report-unreadable"));
}

TEST(ReportPage, ExitCodesTellWhoseFaultItWas) {
  const Folder folder;
  EXPECT_EQ(page_of(folder).exit_code, 2) << "no report";
  EXPECT_EQ(
      limber({"report", (folder / "none").string(), "-o", (folder / "p.html").string()}).exit_code,
      2);
  write_report(folder, "failed@hero", report("fail"));
  EXPECT_EQ(page_of(folder).exit_code, 0) << "the page was made; it shows the failure";
  EXPECT_EQ(page_of(folder, "no/such/folder.html").exit_code, 3);
}

/// Runs a script of Node; its exit code, 77 where it cannot run here.
int node(const std::string& script, const std::string& argument = "") {
  const std::string path = (limber_test::source_root() / "tests/pipeline" / script).string();
  const int status = std::system(("node '" + path + "' '" + argument + "'").c_str());
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST(ReportPage, OrdersFiltersAndCounts) {
  if (printed("command -v node").empty()) GTEST_SKIP() << "node is not installed";
  EXPECT_EQ(node("report_clips.mjs"), 0);
}

TEST(ReportPage, WorksInABrowser) {
  if (printed("command -v node").empty()) GTEST_SKIP() << "node is not installed";
  const Folder folder;
  for (int i = 0; i < 150; ++i) {
    json document = report(i % 10 == 0 ? "fail" : i % 3 == 0 ? "warn" : "pass");
    document["source"]["path"] = "in/take" + std::to_string(i % 7) + ".bvh";
    document["effectors"][0]["position_error_mm"]["p95"] = 45 + 7 * i % 151;
    if (i % 3 == 0) document["warnings"] = {{{"code", "feet-slide"}, {"message", "feet slide"}}};
    write_report(folder, "take" + std::to_string(i) + (i % 2 == 0 ? "@hero" : "@hand"), document);
  }
  hostile_page(folder);
  const int result = node("report_browser.mjs", (folder / "index.html").string());
  if (result == 77) GTEST_SKIP() << "no browser to look at the page with; the reason stands above";
  EXPECT_EQ(result, 0);
}

}  // namespace
