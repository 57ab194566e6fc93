"""What reads programs of absent devices, on literal samples; nothing is compiled."""

import pytest

from benchmarks import absent_device, kernels, programs, programs_report
from benchmarks.program_list import LIMITS, PROGRAMS

PTX = """
.version 8.4
.target sm_90a
.func  (.param .b32 func_retval0) shared_part
(
	.param .b64 shared_part_param_0
)
{
	.reg .b32 	%r<3>;
	ld.param.u64 	%rd1, [shared_part_param_0];
	st.param.b32 	[func_retval0], %r1;
	ret;                                    // -- End function
}
	// .globl	loop_fusion
.visible .entry loop_fusion(
	.param .u64 .ptr .align 128 loop_fusion_param_0
)
.reqntid 128, 1, 1
{
	.reg .pred 	%p<2>;
// %bb.0:
	ld.global.nc.v4.f32 	{%f1, %f2, %f3, %f4}, [%rd1];
	setp.lt.f32 	%p1, %f1, 0f00000000;
	@%p1 bra 	$L__BB1_2;
	{ // callseq 0, 0
	.param .b64 param0;
	st.param.b64 	[param0], %rd2;
	.param .b32 retval0;
	call.uni (retval0),
	shared_part,
	(
	param0
	);
	} // callseq 0
	call.uni (retval0), shared_part, (param0);
$L__BB1_2:
	ret;
}
"""

ASSEMBLED = """\
ptxas info    : 0 bytes gmem
ptxas info    : Compiling entry function 'loop_fusion' for 'sm_90a'
ptxas info    : Function properties for loop_fusion
    16 bytes stack frame, 12 bytes spill stores, 20 bytes spill loads
ptxas info    : Function properties for shared_part
    0 bytes stack frame, 4 bytes spill stores, 0 bytes spill loads
ptxas info    : Used 96 registers, used 0 barriers, 408 bytes cmem[0]
ptxas info    : Compiling entry function 'input_fusion_1' for 'sm_90a'
ptxas info    : Function properties for input_fusion_1
    0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
ptxas info    : Used 12 registers, 352 bytes cmem[0]
"""

OLD_LISTING = (
    "kCommandBuffer\t\n"
    "    kKernel\t, kernel = loop_fusion, launch dimensions = blocks: {2048, 1, 1}, "
    "threads/block: {128, 1, 1}, cluster_dim = nullopt\n"
    "    kCopy\t"
)
NEW_LISTING = (
    "001: kCustomKernel [source | next=002 (1)] loop_fusion grid: [2048, 1, 1] "
    "threads: [128, 1, 1]  shared_memory: 0 bytes\n"
    "002: kCopy [prev=001 (1)]"
)

HLO = """\
%fused (p: f32[8]) -> f32[8] {
  ROOT %loop_fusion = f32[8]{0} negate(%p)
}

ENTRY %main.1 (x.1: f32[4,3], y: f64[4]) -> (pred[4], f32[4]) {
  %x.1 = f32[4,3]{1,0} parameter(0), metadata={op_name="x"}
  %y = f64[4]{0} parameter(1)
  %loop_fusion.2 = (pred[4]{0}, f32[4]{0}) fusion(%x.1, %y, /*index=2*/%x.1), kind=kLoop
  %input_fusion = f32[4]{0} fusion(%loop_fusion.2#1, /*index=1*/%loop_fusion.2#0)
  ROOT %copy-done = f32[4]{0} negate(%y), metadata={op_name="f(%x.1)"}
}
"""


def test_instructions_follow_calls():
    functions = kernels.ptx_functions(PTX)
    assert functions["shared_part"] == (False, 3, [])
    assert functions["loop_fusion"] == (True, 7, ["shared_part", "shared_part"])
    assert kernels.instructions(functions) == {"loop_fusion": 7 + 2 * 3}
    assert kernels.ptx_functions("\n.version 8.4\n") == {}


def test_registers_and_spills_are_of_their_kernel():
    assert kernels.assembled(ASSEMBLED) == {
        "loop_fusion": {"registers": 96, "spilled": 12 + 4},
        "input_fusion_1": {"registers": 12, "spilled": 0},
    }


@pytest.mark.parametrize("listing", [OLD_LISTING, NEW_LISTING])
def test_launches_have_threads(listing):
    assert kernels.launches(listing) == [("loop_fusion", 2048 * 128)]
    assert kernels.other_thunks(listing) == ["kCopy"]


def test_moved_bytes_are_of_each_operand_once():
    moved = kernels.moved(HLO)
    assert moved["loop_fusion_2"] == 4 * (1 + 4) + 4 * 3 * 4 + 4 * 8
    assert moved["copy_done"] == 4 * 4 + 4 * 8
    assert moved["input_fusion"] == 4 * 4 + 4 * 4 + 4 * 1
    with pytest.raises(ValueError, match="no array of the name 'z'"):
        kernels.moved(HLO.replace("fusion(%x.1", "fusion(%z"))


def kernel(**changed):
    usual = {"name": "k", "threads": 10, "instructions": 50, "bytes": 10 * 64}
    return usual | {"registers": 90, "spilled": 0} | changed


def row(*given, **changed):
    facts = {"program": "overlap, minkowski", "pairs": 10, "compile_seconds": 1.0}
    more = {"device_functions": 0, "others": [], "temporary_bytes": 0}
    return facts | more | {"kernels": list(given) or [kernel()]} | changed


def one_set(*rows, **changed):
    about = {"device": "h100", "jax": "0.10.2", "dtype": "float32", "pairs": 10}
    more = {"date": "2026-01-01", "receipt": "abc", "versions": {}, "cores": 2}
    return about | more | {"rows": list(rows)} | changed


def test_the_roofline_is_the_sum_of_what_binds_each_kernel():
    slow = kernel(threads=10, instructions=10**6, bytes=1, spilled=8)
    facts = programs_report.facts(row(kernel(), slow, kernel(bytes=None)))
    assert facts["launched"] == "2 + 1"
    assert facts["instructions"] == 50 + 10**6
    by_memory, by_issue = 64 / 3.35e12, 10**6 / (132 * 128 * 1.755e9)
    assert facts["nanoseconds"] == pytest.approx(1e9 * (by_memory + by_issue))
    assert (facts["bound"], facts["spilled"]) == ("instructions", 8)


def test_limits_are_told():
    assert programs_report.exceeded(row()) == []
    over = row(kernel(instructions=521, spilled=4), temporary_bytes=10)
    said = ["instructions 521", "temporary 1", "spilled 4"]
    assert programs_report.exceeded(over) == said
    late = row(compile_seconds=3.9)
    assert programs_report.exceeded(late, "0.10.2") == ["compile seconds 4"]
    assert programs_report.exceeded(late, "0.12.0.1") == []
    assert set(LIMITS) < set(PROGRAMS)


def test_a_run_replaces_its_like_and_keeps_the_rest():
    first, other = row(), row(program="scaled_distance")
    before = [one_set(first, other), one_set(first, jax="0.6.0")]
    late = row(compile_seconds=9.0)
    same = programs.merged(before, [one_set(late)])
    assert [s["jax"] for s in same] == ["0.6.0", "0.10.2"]
    assert same[1]["rows"] == [late, other]
    newer = programs.merged(before, [one_set(late, receipt="def")])
    assert newer[1]["rows"] == [late]


def test_the_report_has_every_row():
    failed = {"program": "certify", "error": "took longer than 9 s"}
    tpu = {"program": "scaled_distance", "pairs": 10, "fusions": 3, "flops": 1e3}
    tpu |= {"bytes": 2e3, "temporary_bytes": 0, "compile_seconds": 31.0}
    sets = [one_set(row(), failed), one_set(tpu, device="v5e")]
    text = programs_report.text(sets, "abc")
    for word in ("overlap, minkowski", "took longer than 9 s", "compile seconds 31"):
        assert word in text
    assert programs.check(sets) == 2
    assert programs.check([]) == 2


def test_what_fails_or_takes_too_long_says_so():
    sleep = ["timeit", "-n1", "-r1", "import time; time.sleep(60)"]
    assert programs._run(sleep, {}, 0.5) == {"error": "took longer than 0.5 s"}
    found = programs._run(["json.tool", "no such file"], {}, 60)
    assert "no such file" in found["error"]


def test_a_missing_compiler_names_the_extra(monkeypatch):
    monkeypatch.setattr(absent_device, "_folder", lambda name: "")
    assert (
        "'.[compilers]'"
        in programs.measure("v5e", "certify", 10, "float32", 9)["error"]
    )
    with pytest.raises(SystemExit, match="no compiler for h100"):
        programs.main(["--quick"])
