//! prints a run
use emulator::Scenario; use pipeline::*; 
fn main(){ let a:Vec<String>=std::env::args().collect(); let text=Scenario::shipped(&a[1]).map(str::to_owned).unwrap_or_else(||std::fs::read_to_string(&a[1]).unwrap());
 let s=Scenario::parse(&text,"x").unwrap(); let every:u64=a.get(2).map_or(5,|x|x.parse().unwrap());
 let mut n=0; let d=drive(&Settings::of(s),|st|{ n+=1; if n%every!=0 {return}
  let c=st.command.unwrap(); let o=st.obstacles.unwrap();
  print!("{:4} t{:.1} x{:.2} y{:+.2} yaw{:+.2} v{:.2} | kind{} lvl{} st{} reason{} it{} side{:+} slack{:.3} u({:.2},{:+.3}) cl{:.2} |",n,st.truth.time_s,st.truth.x_m,st.truth.y_m,st.truth.yaw_rad,st.truth.speed_mps,c.kind,c.level,c.status,c.reason,c.iterations,c.side,c.slack,c.velocity_mps,c.steering_rad,st.truth.clearance_m);
  for i in o.list(){ print!(" #{}({:.2},{:.2} a{:.2} b{:.2} v{:.2},{:.2} un{:.1})",i.id,i.x_m,i.y_m,i.a_m,i.b_m,i.velocity_x_mps,i.velocity_y_mps,i.unseen_s)} println!();}).unwrap();
 println!("{:?}",d);}
